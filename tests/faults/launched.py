"""`meanflock run` in a process of its own, and the processes that it starts."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from tests.commands import COMMAND
from tests.faults.by_hand import Recorded, spool_bytes
from tests.polling import DEADLINE_S, until

BARRIER_S = 4
ENVIRONMENT = {"MEANFLOCK_BARRIER": str(BARRIER_S)}


def _let_hang_up_end() -> None:
    """SIGHUP ends the process, also where `nohup` runs the tests."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def alive(process: psutil.Process) -> bool:
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


class Launched(Recorded):
    def __init__(self, out: Path, settings: tuple[str, ...], flags: tuple[str, ...], **environment: str) -> None:
        super().__init__(out)
        words = [word for setting in settings for word in ("--set", setting)]
        self.process = subprocess.Popen(
            [*COMMAND, "run", "--out", str(out), "--quiet", "--json", *flags, *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **ENVIRONMENT, **environment},
            preexec_fn=_let_hang_up_end,
        )

    def forker(self) -> psutil.Process:
        (found,) = psutil.Process(self.process.pid).children()
        return found

    def forked(self, module: str) -> list[psutil.Process]:
        """The processes of a module; the one that was started last is first."""
        found = [p for p in self.forker().children() if p.name() == f"mf-{module}"]
        return sorted(found, key=lambda p: (p.create_time(), p.pid), reverse=True)

    def family(self) -> list[psutil.Process]:
        return psutil.Process(self.process.pid).children(recursive=True)

    def ended(self, code: int) -> tuple[str, str]:
        out, err = self.process.communicate(timeout=DEADLINE_S)
        assert self.process.returncode == code, err
        return out, err


@contextmanager
def launched(out: Path, *settings: str, flags: tuple[str, ...] = ("--no-record",), **env: str) -> Iterator[Launched]:
    """A run that has begun to fly, and is ended with the context."""
    run = Launched(out, settings, flags, **env)
    try:
        until(lambda: spool_bytes(run.out) > 20_000, "telemetry")
        yield run
    finally:
        if run.process.poll() is None:
            run.process.kill()
        run.process.communicate()
