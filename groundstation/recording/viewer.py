"""Rerun's own program as a child process: it checks and mends recordings, and shows them.

The binary is started itself, not through the `rerun` script, which leaves the viewer behind when it is ended.
It listens on loopback only and does not phone home.
"""

import http.client
import importlib.util
import logging
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.process import Interrupted

LOOPBACK = "127.0.0.1"
LISTEN_S = 60.0  # until a server that has been started listens, on a machine that is busy
_ASK_AGAIN_S = 0.02

log = logging.getLogger("meanflock.viewer")


def verify(path: Path) -> str | None:
    """What is wrong with a recording; None: nothing."""
    done = _run("rrd", "verify", str(path))
    if done.returncode != 0:
        return _reason(done)
    return None if _holds_a_run(path) else "there is no recording in it"


def repair(path: Path) -> None:
    """Rewrites a recording that was cut off, in place, with all that can be read of it.

    Raises:
        RunFailed: nothing can be read of it; the file is left as it was.
    """
    mended = path.with_name(f".{path.name}.mended")
    try:
        done = _run("rrd", "optimize", str(path), "-o", str(mended))
        if done.returncode != 0 or not mended.exists():
            raise RunFailed(f"{path}: the recording cannot be repaired: {_reason(done)}")
        if not _holds_a_run(mended):
            raise RunFailed(f"{path}: nothing of a flight can be read of the recording; it is left as it was")
        mended.replace(path)
    finally:
        mended.unlink(missing_ok=True)


def _holds_a_run(path: Path) -> bool:
    """Whether there is anything but what says how it is shown; Rerun's program calls a cut beginning sound."""
    from rerun.chunk import RrdReader  # a third of a second, where a recording is looked at

    try:
        RrdReader(path).stream()
    except (RuntimeError, ValueError):  # no file of that kind, nothing but a blueprint
        return False
    return True


class Continued:
    """Lets a new recording be written in the place of an older one of the same run; in the end they are one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.earlier: list[Path] = []  # what there is already, whole; what cannot be read is left aside

    def __enter__(self) -> "Continued":
        # Some may be left by who was killed before it could join them.
        aside = sorted(self._path.parent.glob(f".earlier-*.{self._path.name}"))
        if self._path.exists():
            aside.append(self._path.replace(self._path.with_name(f".earlier-{len(aside):03}.{self._path.name}")))
        for part in aside:
            try:
                if verify(part) is not None:
                    repair(part)
                self.earlier.append(part)
            except RunFailed as error:
                log.warning("%s", error)
        return self

    def __exit__(self, *_: object) -> None:
        """Joins all that can be read; where that fails, the new one stands alone and the others are left aside."""
        if not self.earlier or not self._path.exists():
            return
        joined = self._path.with_name(f".joined.{self._path.name}")
        try:
            parts = [str(part) for part in (*self.earlier, self._path)]
            if _run("rrd", "merge", *parts, "-o", str(joined)).returncode == 0 and joined.exists():
                joined.replace(self._path)
                for part in self.earlier:
                    part.unlink()
        finally:
            joined.unlink(missing_ok=True)


def open_viewer(path_or_url: Path | str) -> "subprocess.Popen[bytes]":
    """Opens a recording, or a live one by its URL, in a window of its own; the caller may wait for its end.

    Raises:
        BadInput: there is no such file.
    """
    target = str(path_or_url)
    if "://" not in target and not Path(target).is_file():
        raise BadInput(f"{target}: no such recording; give the `recording.rrd` of a run, or a rerun+http:// URL")
    return subprocess.Popen([*_program(), target, "--bind", LOOPBACK, "--port", "auto"], env=_environment())


def web_viewer_files(paths: Iterable[str]) -> dict[str, bytes]:
    """The files of the web viewer that Rerun's program has in itself, by their path on its server.

    Raises:
        RunFailed: the program ends before it serves them.
    """
    _, port = listening_address(LOOPBACK, 0)
    shown = f"rerun+http://{LOOPBACK}:{port}/proxy"  # never connected to: it keeps the program from serving data, too
    arguments = ["--serve-web", shown, "--bind", LOOPBACK, "--web-viewer-port", str(port)]
    server = subprocess.Popen([*_program(), *arguments], env=_environment(), stdout=subprocess.DEVNULL)
    try:
        while not answers(LOOPBACK, port):
            if server.poll() is not None:
                raise RunFailed(f"the web viewer ended with {server.returncode}; see `meanflock doctor`")
            time.sleep(_ASK_AGAIN_S)
        return {path: _read(port, path) for path in paths}
    finally:
        end(server)


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
            end(shown)


def end(viewer: "subprocess.Popen[bytes]") -> None:
    """Ends a viewer that still runs: first asked, then killed."""
    viewer.terminate()
    try:
        viewer.wait(timeout=5)
    except subprocess.TimeoutExpired:
        viewer.kill()
        viewer.wait()


def start_headless(path: Path, size: tuple[int, int], log: Path) -> tuple["subprocess.Popen[bytes]", str]:
    """Starts a viewer without a window, `size` in pixels, that writes to `log`; returns it and its URL."""
    _, port = listening_address(LOOPBACK, 0)
    window = f"{size[0]}x{size[1]}"
    arguments = ["--headless", "--bind", LOOPBACK, "--port", str(port), "--window-size", window]
    environment = {**_environment(), "RUST_LOG": "warn"}  # what it logs below that it also lays over the views
    with log.open("wb") as output:
        viewer = subprocess.Popen(
            [*_program(), str(path), *arguments], env=environment, stdout=output, stderr=subprocess.STDOUT
        )
    return viewer, f"rerun+http://{LOOPBACK}:{port}/proxy"


def listening_address(host: str, port: int) -> tuple[str, int]:
    """The numeric address and the port to serve on, 0 being any; rerun itself would only log a failure.

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
    """Whether somebody listens there; 0.0.0.0 and :: are this machine."""
    try:
        socket.create_connection(({"0.0.0.0": LOOPBACK, "::": "::1"}.get(host, host), port), timeout=1.0).close()
    except OSError:
        return False
    return True


def await_listener(host: str, port: int, timeout_s: float = LISTEN_S) -> None:
    """Waits until somebody listens on `host`:`port`.

    Raises:
        RunFailed: nobody does within `timeout_s`.
    """
    end = time.monotonic() + timeout_s
    while not answers(host, port):
        if time.monotonic() > end:
            raise RunFailed(f"nobody serves the recording on {host}:{port} after {timeout_s:g} s; choose another port")
        time.sleep(_ASK_AGAIN_S)


def _run(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([*_program(), *arguments], env=_environment(), capture_output=True, text=True, check=False)


def _program() -> list[str]:
    """Where the wheel put the binary; macOS may have it in a bundle."""
    package = importlib.util.find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise RunFailed("rerun is not installed; pip install 'meanflock[ground]'")
    folder = Path(package.origin).parent
    bundle = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    binary = folder / ("rerun.exe" if sys.platform == "win32" else "rerun")
    return [str(bundle if bundle.exists() else binary)]


def _environment() -> dict[str, str]:
    """The environment of a child that neither asks about analytics nor sends any, and says only what went wrong."""
    return {"RUST_LOG": "warn", **os.environ, "CI": "1", "NO_COLOR": "1"}


def _reason(done: "subprocess.CompletedProcess[str]") -> str:
    """What the program said, on one line."""
    said = " ".join((done.stderr or done.stdout).split())
    return said or f"rerun ended with {done.returncode}"
