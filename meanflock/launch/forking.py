"""The launcher's side of the process that forks the rooms. It is started early, and loads beside the launcher."""

import select
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress

from meanflock.launch import orders
from meanflock.launch.children import Family, environment, sweep
from meanflock.launch.orders import Ended, Loaded, Prepare, Signal, StartOrder
from meanflock.net.process import TERM_GRACE_S

_MODULE = "meanflock.launch.forker"
_SLACK_S = 2.0  # for the process itself, beyond the grace of its forks


class Forker(Family):
    """Context of a process that forks the rooms, and of its forks. At its end none is left."""

    def __init__(self) -> None:
        super().__init__()
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._forked: dict[int, Forked] = {}
        self._loaded: Loaded | None = None
        self.gone = False  # whether the process has ended
        with theirs:
            number = theirs.fileno()
            self.process = self.popen(
                [sys.executable, "-P", "-m", _MODULE, str(number)],
                self.folder / "forker.log",
                environment(),
                pass_fds=[number],
            )

    def may_fork(self) -> bool:
        """Wait until it has loaded everything; returns whether it may fork, which it may not where a plug-in has
        started a thread, or where it fails to load."""
        while self._loaded is None and not self.gone:
            self.look(None)
        return self._loaded is not None and self._loaded.may_fork

    def start(self, number: int, module: str, command: list[str], log: str, ready: int | None = None) -> "Forked":
        """Fork a program. `ready`: descriptor on which it reports that it is ready."""
        self._send(StartOrder(number, module, command, log), [] if ready is None else [ready])
        self._forked[number] = Forked(self, number)
        return self._forked[number]

    def prepare(self, scenario: str, variables: Mapping[str, str], *, has_learner: bool) -> None:
        """Compute what every agent of a flight would compute at its start.

        scenario: its file. variables: of the environment of all forks. has_learner: whether a learner is loaded, which
        may start threads; it then says again whether it may fork.
        """
        if has_learner:
            self._loaded = None
        self._send(Prepare(scenario, dict(variables)))

    def signal(self, number: int, which: int) -> None:
        """Send a signal to a process."""
        self._send(Signal(number, which))

    def _send(self, order: orders.Order, descriptors: Sequence[int] = ()) -> None:
        try:
            socket.send_fds(self._channel, [orders.encode(order)], descriptors)
        except OSError:  # it is gone
            self.look(0.0)

    def look(self, timeout_s: float | None) -> None:
        """Take in all reports that have come; wait for the first one for so long, or without end."""
        while not self.gone and select.select([self._channel], [], [], timeout_s)[0]:
            try:
                raw = self._channel.recv(orders.MOST_BYTES)
            except ConnectionError:
                raw = b""
            report = orders.reports.decode(raw) if raw else None
            if report is None:
                self._end_of_all()
            elif isinstance(report, Ended):
                self._forked[report.number].returncode = report.code
            else:
                self._loaded = report
            timeout_s = 0.0

    def _end_of_all(self) -> None:
        """It has died: its forks end too, by themselves or at the end of this context."""
        self.gone = True
        self.process.wait()
        for process in self._forked.values():
            if process.returncode is None:
                process.returncode = -signal.SIGKILL

    @property
    def died(self) -> bool:
        """Returns whether it has ended although it was needed. If it could not load, each process is started alone."""
        self.look(0.0)
        return self.gone and (self._loaded is not None or (self.process.returncode or 0) < 0)

    def close(self) -> None:
        """End its forks, by SIGTERM, then SIGKILL, and then it."""
        self._channel.close()
        self.gone = True
        if not self._forked:
            self.process.kill()  # it may still be loading
        with suppress(subprocess.TimeoutExpired):  # it is stopped
            self.process.wait(TERM_GRACE_S + _SLACK_S)
        if self.process.returncode != 0:
            sweep(self.process.pid)
            self.process.wait()
        super().close()


class Forked:
    """A process that was forked; has the methods of `Popen` that a launcher needs."""

    def __init__(self, forker: Forker, number: int) -> None:
        self.returncode: int | None = None
        self._forker, self._number = forker, number

    def poll(self) -> int | None:
        """Its exit code if it has ended, minus the signal that killed it; else None."""
        if self.returncode is None:
            self._forker.look(0.0)
        return self.returncode

    def send_signal(self, which: int) -> None:
        """Send it a signal."""
        self._forker.signal(self._number, which)
