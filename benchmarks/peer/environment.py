"""The environment of a peer or a judge, made from the pins of its dependency group, and the process of a peer."""

import hashlib
import os
import selectors
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from types import TracebackType

from benchmarks.machine import ROOT
from benchmarks.processes import BenchmarkFailed
from meanflock.launch.children import sweep
from meanflock.net.process import end_all

FOLDER = ROOT / ".bench"
SCRIPTS = Path(__file__).parent
ANSWER_S = 60.0
_SETTINGS = {"PYTHONDONTWRITEBYTECODE": "1", "FLWR_TELEMETRY_ENABLED": "0", "RAY_USAGE_STATS_ENABLED": "0"}


def pins(peer: str, kind: str = "peer") -> list[str]:
    """Packages of the environment of a peer or of another kind, in the order of installation; from `pyproject.toml`."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    wanted: list[str] = groups[f"{kind}-{peer}"]
    return wanted


class Environment:
    """A virtual environment for one peer; another one as soon as its pins or our interpreter change."""

    def __init__(self, peer: str, folder: Path = FOLDER, kind: str = "peer") -> None:
        self.peer = peer
        self._kind = kind
        self._pins = pins(peer, kind)
        key = hashlib.sha256("\n".join([sys.version, *self._pins]).encode()).hexdigest()[:8]
        self._place = folder / f"{peer}-{key}"
        self._done = self._place / "done"
        self.python = self._place / "bin" / "python"

    def make(self, timeout_s: float) -> str:
        """Makes it if it is not there; says what was done.

        Raises:
            BenchmarkFailed: it cannot be made, or not in time; the text is the last thing the installer said.
        """
        if self._done.is_file():
            return "already there"
        shutil.rmtree(self._place, ignore_errors=True)
        self._place.parent.mkdir(parents=True, exist_ok=True)
        end, log = time.monotonic() + timeout_s, self._place.with_suffix(".log")
        pip = [sys.executable, "-m", "pip", "--python", str(self.python)]  # ours, so that none is installed there
        commands = [[sys.executable, "-m", "venv", "--without-pip", str(self._place)]]
        # Peers one by one: a pin that decides which build of a package others get must be there before them. A judge
        # imports a small part of its libraries, once or twice: that is compiled sooner than all of them.
        first, how = (1, ["-q"]) if self._kind == "peer" else (len(self._pins), ["-q", "--no-compile"])
        commands += [[*pip, "install", *how, *self._pins[:k]] for k in range(first, len(self._pins) + 1)]
        for command in commands:
            install(command, log, end)
        self._done.touch()
        return f"installed {', '.join(self._pins)}"

    def start(self, script: str, *arguments: int | str) -> "Peer":
        """Runs a script of ours with this interpreter and some arguments.

        Raises:
            BenchmarkFailed: it has not been set up.
        """
        if not self._done.is_file():
            raise BenchmarkFailed(f"not set up; python -m benchmarks.peers --setup {self.peer}")
        version = next(pin for pin in self._pins if pin.split("==")[0] == self.peer).replace("==", " ")
        return Peer([str(self.python), str(SCRIPTS / f"{script}.py"), *map(str, arguments)], version)


def install(command: list[str], log: Path, end: float) -> None:
    """Runs one step of an installation until `end` on the monotonic clock, its words going to `log`.

    Raises:
        BenchmarkFailed: not done in time, or failed; the text is the last error it said.
    """
    with log.open("ab") as output:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
        )
        try:
            code = process.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            raise BenchmarkFailed(f"not installed in time, see {log.name}") from None
        finally:
            end_all([process])
    if code:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        errors = [line for line in lines if line.startswith("ERROR")] or lines or ["it said nothing"]
        raise BenchmarkFailed(errors[-1])


class Peer:
    """A peer's process in a folder of its own, ready to be timed; a context manager that ends it."""

    def __init__(self, command: list[str], version: str) -> None:
        """Raises BenchmarkFailed where it does not get ready."""
        self.version = version
        self._unread = b""
        self._folder = tempfile.TemporaryDirectory(prefix="peer-", ignore_cleanup_errors=True)
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed in `close`
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            cwd=self._folder.name,
            env=os.environ | _SETTINGS | {"TMPDIR": self._folder.name, "FLWR_HOME": self._folder.name},
            start_new_session=True,
        )
        try:
            if self._line() != "ready":
                raise BenchmarkFailed("it did not say that it is ready")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Peer":
        return self

    def __exit__(self, _t: type[BaseException] | None, _e: BaseException | None, _b: TracebackType | None) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid

    def measure(self, count: int) -> float:
        """Its mean time of `count` times its work, ms.

        Raises:
            BenchmarkFailed: no answer within a minute, or it ended.
        """
        assert self._process.stdin is not None
        self._process.stdin.write(f"{count}\n".encode())
        self._process.stdin.flush()
        return float(self._line())

    def close(self) -> None:
        """Ends it and what it started; what it wrote goes with it."""
        end_all([self._process])
        sweep(self._process.pid)  # ray's daemons outlive it where it had to be killed
        for file in (self._process.stdin, self._process.stdout, self._log):
            if file is not None:
                file.close()
        self._folder.cleanup()

    def _line(self) -> str:
        assert self._process.stdout is not None
        end = time.monotonic() + ANSWER_S
        with selectors.DefaultSelector() as waiting:
            waiting.register(self._process.stdout, selectors.EVENT_READ)
            while b"\n" not in self._unread:
                if not waiting.select(max(0.0, end - time.monotonic())):
                    raise BenchmarkFailed(f"no answer within {ANSWER_S:.0f} s")
                more = os.read(self._process.stdout.fileno(), 4096)
                if not more:
                    self._log.seek(0)
                    last = self._log.read().decode(errors="replace").splitlines()[-1:]
                    raise BenchmarkFailed(f"it ended: {last[0] if last else 'it said nothing'}")
                self._unread += more
        line, self._unread = self._unread.split(b"\n", 1)
        return line.decode()
