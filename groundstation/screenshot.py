"""A recording as a picture, rendered by a viewer that needs no display."""

import subprocess
import tempfile
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from groundstation import blueprint as look
from groundstation.durable import check_writable
from groundstation.viewer import start_headless
from swarm.errors import BadInput, RunFailed

VIEWER_DEADLINE_S = 60.0  # software rendering on a busy machine
MISSING_GRAPHICS = "apt-get install mesa-vulkan-drivers libgl1 libegl1"


def screenshot(path: Path, png: Path, at_s: float, size: tuple[int, int] = (1920, 1080)) -> None:
    """Renders a recording at `at_s` seconds of flight as a picture of `size` pixels; needs no display.

    Raises:
        BadInput: no such recording, or the picture cannot be written.
        RunFailed: the viewer does not start or answer, or one of the views reports an error.
    """
    if not path.is_file():
        raise BadInput(f"{path}: no such recording; give the `recording.rrd` of a run")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "viewer.log"
        viewer, url = start_headless(path, size, log)
        try:
            picture = _render(viewer, url, at_s)
        except (OSError, RuntimeError, ValueError) as error:
            said = log.read_text(encoding="utf-8", errors="replace").splitlines()
            cause = next((line for line in said if "panicked" in line or "ERROR" in line), str(error))
            raise RunFailed(
                f"{path}: no picture: {cause}; without a display the viewer needs software rendering: "
                f"{MISSING_GRAPHICS}"
            ) from error
        finally:
            viewer.terminate()
            try:
                viewer.wait(timeout=5)
            except subprocess.TimeoutExpired:
                viewer.kill()
                viewer.wait()
    check_writable(png)
    png.write_bytes(picture)


def _render(viewer: "subprocess.Popen[bytes]", url: str, at_s: float) -> bytes:
    """The picture once the recording is loaded and no new picture comes any more.

    Two in a row need not be the same: a plot may swap for ever between two widths of its labels.
    """
    deadline = time.monotonic() + VIEWER_DEADLINE_S
    client: ViewerClient | None = None
    prepared = False
    pictures: set[bytes] = set()
    while time.monotonic() < deadline:
        if viewer.poll() is not None:
            raise OSError(f"the viewer ended with {viewer.returncode}")
        time.sleep(0.2)  # between two questions
        try:
            client = client or ViewerClient.connect(url)
            seen = client.get_state()
            if not seen.recordings or not seen.recordings[0].timelines or seen.loading:
                continue
            if not prepared:
                client.set_time(look.TIMELINE, duration=at_s, play_state="paused")
                client.run_command("ui.toggle_top_panel")  # it only says that this is a software rasterizer
                prepared = True
                continue
            picture = client.take_screenshot()
        except (RuntimeError, ConnectionError):
            continue  # not listening yet
        if picture in pictures:
            reports = [(view.name, report) for view in seen.views for report in view.reports]
            errors = [f"{name}: {report.summary}" for name, report in reports if report.severity == "error"]
            if errors:
                raise RunFailed(f"views report errors: {'; '.join(errors)}")
            return picture
        pictures.add(picture)
    raise TimeoutError(f"the viewer gave no steady picture within {VIEWER_DEADLINE_S:.0f} s")
