"""A recording as a picture, rendered by a viewer that needs no display."""

import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rerun.experimental import ViewerClient

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording.viewer import end, start_headless
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput, RunFailed

VIEWER_DEADLINE_S = 60.0  # software rendering on a busy machine
LEAST, MOST = 200, 8192  # pixels of a side
MISSING_GRAPHICS = "apt-get install mesa-vulkan-drivers libgl1 libegl1"


def pixels(size: str) -> tuple[int, int]:
    """`WIDTHxHEIGHT`, as somebody gave it.

    Raises:
        BadInput: it is not, or too small to show anything or too large to render.
    """
    numbers = [int(part) for part in size.split("x") if part.isascii() and part.isdigit()]
    if size.count("x") != 1 or len(numbers) != 2 or not all(LEAST <= number <= MOST for number in numbers):
        raise BadInput(f"--size {size}: write it as WIDTHxHEIGHT, each {LEAST} to {MOST} pixels, for example 1920x1080")
    return numbers[0], numbers[1]


def screenshot(path: Path, png: Path, at_s: float | None, size: tuple[int, int] = (1920, 1080)) -> None:
    """Renders a recording as a picture of `size` pixels; needs no display.

    Args:
        at_s: seconds since take-off; None for the end of the recording.

    Raises:
        BadInput: no such recording or second, or the picture cannot be written.
        RunFailed: the viewer does not start or answer, or one of the views reports an error.
    """
    if not path.is_file():
        raise BadInput(f"{path}: no such recording; give the `recording.rrd` of a run")
    try:
        png.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{png}: {error.strerror}; give a file in a folder that can be written") from error
    durable.check_folder(png.parent, "-o")
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
            end(viewer)
    durable.put(png, picture, "the picture is not written")


def _render(viewer: "subprocess.Popen[bytes]", url: str, at_s: float | None) -> bytes:
    """The picture once the recording is loaded and no new picture comes any more.

    Two in a row need not be the same: a plot may swap for ever between two widths of its labels.
    """
    deadline = time.monotonic() + VIEWER_DEADLINE_S
    client: ViewerClient | None = None
    prepared = False
    pictures: set[bytes] = set()
    while time.monotonic() < deadline:
        if viewer.poll() == -signal.SIGINT:  # Ctrl-C goes to both of us
            raise KeyboardInterrupt
        if viewer.returncode is not None:
            raise OSError(f"the viewer ended with {viewer.returncode}")
        time.sleep(0.2)  # between two questions
        try:
            client = client or ViewerClient.connect(url)
            seen = client.get_state()
            if not seen.recordings or not seen.recordings[0].timelines or seen.loading:
                continue
            if not prepared:
                client.set_time(look.TIMELINE, duration=_second(seen.recordings[0], at_s), play_state="paused")
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


def _second(recording: Any, at_s: float | None) -> float:
    """The second to show: `at_s`, if the recording has it, or its last."""
    (flight,) = [line for line in recording.timelines if line.name == look.TIMELINE]
    first, last = (
        np.timedelta64(nanoseconds, "ns") / np.timedelta64(1, "s") for nanoseconds in (flight.start, flight.end)
    )
    if at_s is None:
        return float(last)
    if not first <= at_s <= last:
        raise BadInput(f"--at {at_s:g}: the recording is of {first:g} to {last:g} s")
    return at_s
