"""Child processes of a launcher: their start, their output, and their end."""

import os
import signal
import site
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, Self

from meanflock import swarm
from meanflock.launch.temporary import TemporaryFolder
from meanflock.net.process import CHILD, READY
from meanflock.swarm.errors import printable_lines

LAST_LINES = 8
# Variables of processes that are started by hand. Here the launcher sets these options.
_FLAGS = ("ENDPOINT", "RUN", "TLS", "WAIT", "SCENARIO", "SET", "STATIONS", "REALTIME", "METRICS", "UAVS_PER_PROCESS")
_OURS = {f"MEANFLOCK_{flag}" for flag in (*_FLAGS, "STEER", "RESUME", "ROWS", "UAV", "COUNT")} | {READY}
_ERROR = "error: "  # prefix of the last line of a process that fails
_GONE_S = 5.0  # most time that a killed process group may take to end


class Family:
    """Context of child processes, with a folder for their output. At its end no child is left."""

    def __init__(self) -> None:
        self._folder = TemporaryFolder()
        self.folder = self._folder.path
        # The reading end of this pipe is the standard input of every child. When this process dies, for any reason, the
        # children read the end of the pipe.
        self._stdin, self._hold = os.pipe()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def popen(
        self,
        command: Sequence[str],
        log: Path,
        environment: Mapping[str, str],
        cwd: Path | None = None,
        pass_fds: Sequence[int] = (),
    ) -> "subprocess.Popen[bytes]":
        """Start a process whose output is appended to a log. `pass_fds`: descriptors that it inherits."""
        with log.open("ab") as output:
            return subprocess.Popen(
                command,
                cwd=cwd,
                stdin=self._stdin,
                stdout=subprocess.DEVNULL,
                stderr=output,
                env={**environment, CHILD: "1"},
                pass_fds=pass_fds,
                start_new_session=True,  # so that this process handles Ctrl-C in the terminal
            )

    def close(self) -> None:
        """Delete the output of the children."""
        for descriptor in (self._hold, self._stdin):
            if descriptor >= 0:
                os.close(descriptor)
        self._hold = self._stdin = -1
        self._folder.delete()


class Process(Protocol):
    """A process that a launcher has started or had forked."""

    @property
    def returncode(self) -> int | None:
        """Its exit code if it is known to have ended, minus the signal that killed it; else None."""

    def poll(self) -> int | None:
        """The same after a look."""

    def send_signal(self, sig: int, /) -> None:
        """Send it a signal."""


@dataclass
class Log:
    """File of the output of one process, or of several that do the same. `name`: of the process, or of all."""

    name: str
    path: Path
    passed_on: int = 0  # bytes that were copied to standard error

    def whole_lines(self) -> str:
        """The whole lines that were not yet passed on."""
        if not self.path.exists():
            return ""
        with self.path.open("rb") as log:
            log.seek(self.passed_on)
            text = log.read()
        whole = text[: text.rfind(b"\n") + 1]
        self.passed_on += len(whole)
        return printable_lines(whole.decode(errors="replace"))

    def _text(self) -> str:
        return printable_lines(self.path.read_text(encoding="utf-8", errors="replace")) if self.path.exists() else ""

    def last_lines(self) -> str:
        """The last lines."""
        text = self._text().strip() or "(no output)"
        return "\n".join(f"    {line}" for line in text.split("\n")[-LAST_LINES:])

    def errors(self) -> list[str]:
        """The error lines."""
        return [line.removeprefix(_ERROR) for line in self._text().split("\n") if line.startswith(_ERROR)]


@dataclass
class Child:
    """One process of the swarm, and the log of its output. `number`: among all of them."""

    number: int
    name: str
    module: str
    command: list[str]
    log: Log
    process: Process = field(init=False)  # set when it is launched
    given_up: bool = False  # it failed and is not started again


def environment() -> dict[str, str]:
    """The environment of a child: that of this process without variables that would change what it flies, and with the
    path to the packages of a checkout that is not installed."""
    kept = {name: text for name, text in os.environ.items() if name not in _OURS}
    root = str(Path(swarm.__file__).parents[2])
    if root not in site.getsitepackages():
        kept["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")]))
    return kept


def sweep(group: int) -> None:
    """Kill the remaining members of a process group, and wait until they are gone."""
    end = time.monotonic() + _GONE_S
    with suppress(ProcessLookupError):
        while time.monotonic() < end:
            os.killpg(group, signal.SIGKILL)
            time.sleep(0.01)


def kill_all(processes: Sequence["subprocess.Popen[bytes]"]) -> None:
    """Kill the process groups that these processes lead."""
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
