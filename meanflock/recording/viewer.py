"""Rerun's own program as a child process: it shows recordings in a window, as a picture or to the web page.

The binary is started directly, because the `rerun` script leaves the viewer behind when it is ended. It listens on
loopback only and sends no analytics.
"""

import http.client
import importlib.util
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from rerun.experimental import ViewerClient

from meanflock.net.process import Interrupted, end_all
from meanflock.recording import blueprint
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput, RunFailed

LOOPBACK = "127.0.0.1"
LISTEN_S = 60.0  # until a server that was started listens, on a busy machine
_ASK_AGAIN_S = 0.02
VIEWER_DEADLINE_S = 60.0  # until a picture is rendered in software, on a busy machine
LEAST, MOST = 200, 8192  # pixels of a side
VIEWS = ("all", "map", "space")  # that a picture can show
MISSING_GRAPHICS = "apt-get install mesa-vulkan-drivers libgl1 libegl1"


def open_viewer(path_or_url: Path | str) -> "subprocess.Popen[bytes]":
    """Opens a recording, or a live one by its URL, in a window of its own; the caller may wait for its end.

    Raises:
        BadInput: there is no such file.
    """
    if isinstance(path_or_url, Path) and not path_or_url.is_file():
        raise BadInput(f"{path_or_url}: no such recording; give the `recording.rrd` of a run, or a rerun+http:// URL")
    target = str(path_or_url.absolute() if isinstance(path_or_url, Path) else path_or_url)
    return subprocess.Popen([*_program(), target, "--bind", LOOPBACK, "--port", "auto"], env=_environment())


def web_viewer_files(paths: Iterable[str]) -> dict[str, bytes]:
    """The files of the web viewer within Rerun's program, by their path on its server.

    Raises:
        RunFailed: the program ends before it serves them.
    """
    _, port = listening_address(LOOPBACK, 0)
    shown = f"rerun+http://{LOOPBACK}:{port}/proxy"  # never opened; without it the program would serve data, too
    arguments = ["--serve-web", shown, "--bind", LOOPBACK, "--web-viewer-port", str(port)]
    server = subprocess.Popen([*_program(), *arguments], env=_environment(), stdout=subprocess.DEVNULL)
    try:
        while not answers(LOOPBACK, port):
            if server.poll() is not None:
                raise RunFailed(f"the web viewer ended with {server.returncode}; see `meanflock doctor`")
            time.sleep(_ASK_AGAIN_S)
        return {path: _read(port, path) for path in paths}
    finally:
        end_all([server])


def _read(port: int, path: str) -> bytes:
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=LISTEN_S)
    try:
        connection.request("GET", path)
        return connection.getresponse().read()
    finally:
        connection.close()


def attend(shown: "subprocess.Popen[bytes]") -> None:
    """Waits until a viewer is closed; Ctrl-C closes it.

    Raises:
        RunFailed: it ended by itself, with an error.
    """
    with Interrupted() as interrupted:
        try:
            while shown.poll() is None and not interrupted:
                with suppress(subprocess.TimeoutExpired):
                    shown.wait(timeout=0.2)
            if shown.returncode and not interrupted:
                raise RunFailed(
                    f"the viewer ended with {shown.returncode}; `meanflock picture` and `view --web` need no window"
                )
        finally:
            end_all([shown])


def start_headless(path: Path, size: tuple[int, int], log: Path) -> tuple["subprocess.Popen[bytes]", str]:
    """Starts a viewer of `size` pixels without a window, which logs to `log`; returns the process and its URL."""
    _, port = listening_address(LOOPBACK, 0)
    window = f"{size[0]}x{size[1]}"
    arguments = ["--headless", "--bind", LOOPBACK, "--port", str(port), "--window-size", window]
    environment = {**_environment(), "RUST_LOG": "warn"}  # it would show lesser messages over the views
    with log.open("wb") as output:
        viewer = subprocess.Popen(
            [*_program(), str(path.absolute()), *arguments], env=environment, stdout=output, stderr=subprocess.STDOUT
        )
    return viewer, f"rerun+http://{LOOPBACK}:{port}/proxy"


def listening_address(host: str, port: int) -> tuple[str, int]:
    """The numeric address and the port to serve on, 0 being any; Rerun itself would only log a failure.

    Raises:
        BadInput: `port` is taken, or `host` is not this machine.
    """
    try:
        address = str(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][4][0])
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as probe:
            if os.name == "posix":  # a port just closed is free; elsewhere the option would share one in use
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((address, port))
            return address, int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"cannot serve the recording on {host}:{port}: {reason}; choose another port, or 0") from error


def answers(host: str, port: int) -> bool:
    """Returns whether a server listens there; 0.0.0.0 and :: are this machine."""
    try:
        socket.create_connection(({"0.0.0.0": LOOPBACK, "::": "::1"}.get(host, host), port), timeout=1.0).close()
    except OSError:
        return False
    return True


def await_listener(host: str, port: int, timeout_s: float = LISTEN_S) -> None:
    """Waits until a server listens on `host`:`port`.

    Raises:
        RunFailed: none does within `timeout_s`.
    """
    end = time.monotonic() + timeout_s
    while not answers(host, port):
        if time.monotonic() > end:
            raise RunFailed(f"no server of the recording on {host}:{port} after {timeout_s:g} s; choose another port")
        time.sleep(_ASK_AGAIN_S)


def run_program(*arguments: str | Path) -> "subprocess.CompletedProcess[str]":
    """Runs Rerun's program to its end. It gets whole paths: it takes some others for options or URLs."""
    words = [str(each.absolute()) if isinstance(each, Path) else each for each in arguments]
    return subprocess.run([*_program(), *words], env=_environment(), capture_output=True, text=True, check=False)


def _program() -> list[str]:
    """The binary in the installed wheel; on macOS it may lie in a bundle."""
    package = importlib.util.find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise RunFailed("the program of rerun is not installed; pip install 'meanflock[ground]'")
    folder = Path(package.origin).parent
    bundle = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    binary = folder / ("rerun.exe" if sys.platform == "win32" else "rerun")
    return [str(bundle if bundle.exists() else binary)]


def _environment() -> dict[str, str]:
    """The environment of a child that sends no analytics and logs only warnings and errors."""
    return {"RUST_LOG": "warn", **os.environ, "CI": "1", "NO_COLOR": "1"}


def reason(done: "subprocess.CompletedProcess[str]") -> str:
    """The output of a program that failed, on one line."""
    output = " ".join((done.stderr or done.stdout).split())
    return output or f"rerun ended with {done.returncode}"


def pixels(size: str) -> tuple[int, int]:
    """Reads `WIDTHxHEIGHT`.

    Raises:
        BadInput: it is something else, too small to show anything, or too large to render.
    """
    numbers = [int(part) for part in size.split("x") if part.isascii() and part.isdigit()]
    if size.count("x") != 1 or len(numbers) != 2 or not all(LEAST <= number <= MOST for number in numbers):
        raise BadInput(f"--size {size}: write it as WIDTHxHEIGHT, each {LEAST} to {MOST} pixels, for example 1920x1080")
    return numbers[0], numbers[1]


def screenshot(
    path: Path, png: Path, at_s: float | None, size: tuple[int, int] = (1920, 1080), view: str = VIEWS[0]
) -> None:
    """Renders a recording as a picture of `size` pixels; needs no display.

    Args:
        at_s: seconds since take-off; None for the end of the recording.
        view: one of `VIEWS`; `map` and `space` fill the picture.

    Raises:
        BadInput: no such recording, second or view, or the picture cannot be written.
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
            picture = _render(viewer, url, at_s, view)
        except (OSError, RuntimeError, ValueError) as error:
            lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
            cause = next((line for line in lines if "panicked" in line or "ERROR" in line), str(error))
            raise RunFailed(
                f"{path}: no picture: {cause}; without a display the viewer needs software rendering: "
                f"{MISSING_GRAPHICS}"
            ) from error
        finally:
            end_all([viewer])
    durable.put(png, picture)


def _render(viewer: "subprocess.Popen[bytes]", url: str, at_s: float | None, view: str) -> bytes:
    """The picture once the recording is loaded and the viewer repeats an earlier picture.

    Two pictures in a row need not be equal: a plot may alternate between two widths of its labels.
    """
    deadline = time.monotonic() + VIEWER_DEADLINE_S
    client: ViewerClient | None = None
    prepared = False
    pictures: set[bytes] = set()
    while time.monotonic() < deadline:
        if viewer.poll() == -signal.SIGINT:  # Ctrl-C reaches both processes
            raise KeyboardInterrupt
        if viewer.returncode is not None:
            raise OSError(f"the viewer ended with {viewer.returncode}")
        time.sleep(0.2)
        try:
            client = client or ViewerClient.connect(url)
            seen = client.get_state()
            if not seen.recordings or not seen.recordings[0].timelines or seen.loading:
                continue
            second = np.timedelta64(round(_second(seen.recordings[0], at_s) * 1e9), "ns")
            second = np.timedelta64(round(_second(seen.recordings[0], at_s) * 1e9), "ns")
            if not prepared or seen.recordings[0].current_time != second.astype(int):  # at first the viewer plays
                client.set_time(blueprint.TIMELINE, duration=second, play_state="paused")
                pictures.clear()
                if not prepared:
                    client.run_command("ui.toggle_top_panel")  # its only message is that it renders in software
                    if view != "all":
                        _fill(client, _found(seen.views, view))
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


def _found(views: Iterable[Any], view: str) -> str:
    """The identity of the map, or of the view in space, among the views of a recording."""
    maps = [each for each in views if each.view_class == "2D" and not each.origin.endswith(blueprint.CLOSE_UP)]
    found = maps if view == "map" else [each for each in views if each.view_class == "3D"]
    if not found:
        raise BadInput(f"--view {view}: the flight is in the plane, or was recorded before 2.0; take `map` or `all`")
    if len(found) > 1:
        raise BadInput(f"--view {view}: the recording shows {len(found)} flights; take `all`")
    return str(found[0].view_id)


def _fill(client: ViewerClient, view_id: str) -> None:
    """Shows a view alone, without the controls of time."""
    shown = client.get_blueprint()
    shown.blueprint["/viewport"]["ViewportBlueprint"]["maximized"] = view_id
    shown.blueprint["/time_panel"]["TimePanelBlueprint"]["state"] = "Hidden"
    client.set_blueprint(shown.blueprint, store_id=shown.store_id)


def _second(recording: Any, at_s: float | None) -> float:
    """The second to show: `at_s`, if the recording has it, or its last."""
    (flight,) = [line for line in recording.timelines if line.name == blueprint.TIMELINE]
    first, last = (
        np.timedelta64(nanoseconds, "ns") / np.timedelta64(1, "s") for nanoseconds in (flight.start, flight.end)
    )
    if at_s is None:
        return float(last)
    if not first <= at_s <= last:
        raise BadInput(f"--at {at_s:g}: the recording is of {first:g} to {last:g} s")
    return at_s
