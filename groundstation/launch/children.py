"""The processes that a launcher has started: what they said, and their ends."""

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
_ERROR = "error: "  # before the line with which a process ends badly
_GONE_S = 5.0  # most time that a killed process group may take to end


class Family:
    """Processes of this one, with a folder for what they say; a context manager that leaves none behind."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="meanflock-")
        self.folder = Path(self._folder.name)
        # Every child holds the reading end of this pipe as its standard input; when this process dies, however it
        # dies, they read its end.
        self._stdin, self._hold = os.pipe()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def popen(
        self, command: Sequence[str], log: Path, environment: Mapping[str, str], cwd: Path | None = None
    ) -> "subprocess.Popen[bytes]":
        """Starts one, whose words are added to a log."""
        with log.open("ab") as output:
            return subprocess.Popen(
                command,
                cwd=cwd,
                stdin=self._stdin,
                stdout=subprocess.DEVNULL,
                stderr=output,
                env={**environment, CHILD: "1"},
                start_new_session=True,  # Ctrl-C in the terminal is this process's to handle
            )

    def close(self) -> None:
        """Forgets what they said; whoever ended them has heard it."""
        for descriptor in (self._hold, self._stdin):
            if descriptor >= 0:
                os.close(descriptor)
        self._hold = self._stdin = -1
        self._folder.cleanup()


@dataclass
class Child:
    """One process of the swarm, and where its words go."""

    name: str
    module: str
    command: list[str]
    log: Path
    process: "subprocess.Popen[bytes]" = field(init=False)  # once it is launched
    given_up: bool = False  # it ended badly and is not started again
    passed_on: int = 0  # bytes of the log that standard error has had

    def last_lines(self) -> str:
        """The end of what it said."""
        said = self.log.read_text(encoding="utf-8", errors="replace").strip() or "(it said nothing)"
        return "\n".join(f"    {line}" for line in printable_lines(said).split("\n")[-LAST_LINES:])

    def errors(self) -> list[str]:
        """What it said was wrong, a line each."""
        said = printable_lines(self.log.read_text(encoding="utf-8", errors="replace")).split("\n")
        return [line.removeprefix(_ERROR) for line in said if line.startswith(_ERROR)]


def sweep(group: int) -> None:
    """Kills what is left of a process group whose leader is gone, and waits until it is gone."""
    end = time.monotonic() + _GONE_S
    with suppress(ProcessLookupError):
        while time.monotonic() < end:
            os.killpg(group, signal.SIGKILL)
            time.sleep(0.01)


def has_members(group: int) -> bool:
    """Whether anybody is left of a process group."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def kill_all(processes: Sequence["subprocess.Popen[bytes]"]) -> None:
    """Kills those that still run and what they have forked, each of which leads a process group."""
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
