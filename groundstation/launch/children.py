"""Child processes of a launcher: their start, their output, and their end."""

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from meanflock.swarm.errors import printable_lines
from meanflock.swarm.process import CHILD

LAST_LINES = 8
_ERROR = "error: "  # prefix of the last line of a process that fails
_GONE_S = 5.0  # most time that a killed process group may take to end


class Family:
    """Context of child processes, with a folder for their output. At its end no child is left."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="meanflock-")
        self.folder = Path(self._folder.name)
        # The reading end of this pipe is the standard input of every child. When this process dies, for any reason, the
        # children read the end of the pipe.
        self._stdin, self._hold = os.pipe()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def popen(
        self, command: Sequence[str], log: Path, environment: Mapping[str, str], cwd: Path | None = None
    ) -> "subprocess.Popen[bytes]":
        """Start a process whose output is appended to a log."""
        with log.open("ab") as output:
            return subprocess.Popen(
                command,
                cwd=cwd,
                stdin=self._stdin,
                stdout=subprocess.DEVNULL,
                stderr=output,
                env={**environment, CHILD: "1"},
                start_new_session=True,  # so that this process handles Ctrl-C in the terminal
            )

    def close(self) -> None:
        """Delete the output of the children."""
        for descriptor in (self._hold, self._stdin):
            if descriptor >= 0:
                os.close(descriptor)
        self._hold = self._stdin = -1
        self._folder.cleanup()


@dataclass
class Child:
    """One process of the swarm, and the file of its output."""

    name: str
    module: str
    command: list[str]
    log: Path
    process: "subprocess.Popen[bytes]" = field(init=False)  # set when it is launched
    given_up: bool = False  # it failed and is not started again
    passed_on: int = 0  # bytes of the log that were copied to standard error

    def last_lines(self) -> str:
        """Last lines of its output."""
        text = self.log.read_text(encoding="utf-8", errors="replace").strip() or "(no output)"
        return "\n".join(f"    {line}" for line in printable_lines(text).split("\n")[-LAST_LINES:])

    def errors(self) -> list[str]:
        """Error lines of its output."""
        text = printable_lines(self.log.read_text(encoding="utf-8", errors="replace")).split("\n")
        return [line.removeprefix(_ERROR) for line in text if line.startswith(_ERROR)]


def sweep(group: int) -> None:
    """Kill the remaining members of a process group, and wait until they are gone."""
    end = time.monotonic() + _GONE_S
    with suppress(ProcessLookupError):
        while time.monotonic() < end:
            os.killpg(group, signal.SIGKILL)
            time.sleep(0.01)


def has_members(group: int) -> bool:
    """Returns whether a process group has members."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def kill_all(processes: Sequence["subprocess.Popen[bytes]"]) -> None:
    """Kill the process groups that these processes lead."""
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
