"""Processes forked from this one, which has loaded what they need: their start, signals to them, and their end.

Memory that no fork writes to exists once, and modules are imported once. A fork is a full process with its own session.
It must be made before this process has other threads, because a fork does not copy them.
"""

import gc
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from meanflock.net.process import CHILD, TERM_GRACE_S

SAFE = sys.platform == "linux"  # elsewhere system libraries may not survive a fork
_ENDING_S = 1.0  # longest wait for a thread that is ending
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)


class Forks:
    """All forks of this process, each with a number.

    Their standard input is a pipe that this process holds open. When this process dies, for any reason, they read its
    end, as children of a launcher do.

    Attributes:
        living: the number of each living fork, by process id.
    """

    def __init__(self) -> None:
        self.living: dict[int, int] = {}
        self._stdin, self._hold = os.pipe()
        self._woken, self._wakes = os.pipe()  # a byte for every signal
        for end in (self._woken, self._wakes):
            os.set_blocking(end, False)
        signal.set_wakeup_fd(self._wakes, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, _notice)

    def fork(self, number: int) -> bool:
        """Fork a process; returns false, and in the fork true."""
        gc.freeze()  # so that the collector does not write to shared memory
        with _held(_SIGNALS):  # one that comes too early is the fork's
            pid = os.fork()
            if pid == 0:
                self._become_a_process()
                return True
        self.living[pid] = number
        return False

    def _become_a_process(self) -> None:
        self.living = {}
        signal.set_wakeup_fd(-1)
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        os.dup2(self._stdin, 0)  # `orphaned` waits for its end
        for end in {self._stdin, self._hold, self._woken, self._wakes} - {0}:
            os.close(end)
        os.environ[CHILD] = "1"

    def wait(self, timeout_s: float | None, readable: Sequence[int] = (), writable: Sequence[int] = ()) -> None:
        """Wait for a signal, such as the end of a fork, or until one of these descriptors is ready."""
        select.select([self._woken, *readable], writable, [], timeout_s)
        with suppress(BlockingIOError):
            os.read(self._woken, 4096)

    def ended(self) -> Iterator[tuple[int, int]]:
        """Number and exit code of every fork that has ended since; minus the signal if it was killed."""
        while self.living:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if not pid:
                return
            if (number := self.living.pop(pid, None)) is not None:
                yield number, os.waitstatus_to_exitcode(status)

    def signal(self, which: int, number: int) -> None:
        """Send a signal to the fork of that number, if it lives."""
        for pid, found in self.living.items():  # none has been reaped, so the ids are still theirs
            if found == which:
                os.kill(pid, number)

    def end_all(self, grace_s: float = TERM_GRACE_S) -> None:
        """End all forks, for good: SIGTERM, then SIGKILL for those that outlive `grace_s`."""
        if self._hold >= 0:
            os.close(self._hold)  # so that they wait for nobody
            self._hold = -1
        end = time.monotonic() + grace_s
        for number in (signal.SIGTERM, signal.SIGCONT):  # a stopped process handles no signal
            self._signal_all(number)
        while True:
            for _ in self.ended():  # reaps them
                pass
            if not self.living:
                return
            left = end - time.monotonic()
            if left <= 0:
                self._signal_all(signal.SIGKILL)
            self.wait(max(0.01, left))

    def _signal_all(self, number: int) -> None:
        for pid in self.living:
            os.kill(pid, number)


def is_alone() -> bool:
    """Returns whether this process has no other thread, so that it may fork; waits for threads that are ending.

    The system has a thread a moment longer than Python, also after `join`.
    """
    end = time.monotonic() + _ENDING_S
    while (threads := _threads()) > 1 == threading.active_count() and time.monotonic() < end:
        time.sleep(0.001)
    return threads == 1


def _threads() -> int:
    """Threads of this process that the system has; 0 where it does not tell."""
    return len(os.listdir("/proc/self/task")) if SAFE else 0


def show_as(name: str) -> None:
    """Name this process in lists of processes, such as `ps` without options and `top`: `mf-` and at most 12 letters."""
    with suppress(OSError):  # not Linux, or forbidden
        Path("/proc/self/comm").write_text(f"mf-{name}", encoding="ascii")


def batch() -> None:
    """Run this process so that a message that wakes it does not preempt the process that computes.

    So there are fewer context switches, and the world can send all requests at once.
    """
    with suppress(AttributeError, OSError):  # no Linux, or forbidden
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


@contextmanager
def _held(signals: Sequence[signal.Signals]) -> Iterator[None]:
    """Context in which these signals wait."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _notice(_number: int, _frame: object) -> None:
    """Handler of SIGCHLD: without one, no byte is written."""
