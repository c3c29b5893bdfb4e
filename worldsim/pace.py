"""Who keeps the flight waiting, tick after tick: a node that answers just before it would be lost is lost, too."""

import logging
from typing import NamedTuple

from meanflock.swarm.scenario import tables
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.members import LEADER
from meanflock.worldsim.reporter import Note

log = logging.getLogger("meanflock.world")


class _Account(NamedTuple):
    slow: float  # replies, less what was forgiven since
    tick: int  # of the last of them


class Pace:
    """Counts slow replies, each node for itself: warned of at half of what it may have, lost at all of it.

    A reply is slow beyond `slow_s` and `slow_factor` times what half of the nodes that were asked took; looked at is
    ten times a second. One slow reply is forgiven for every `FORGIVEN_TICKS` without one. The lives of an agent have
    one account; leaders that stand by each their own.
    """

    FORGIVEN_TICKS = 100

    def __init__(self, rules: tables.Pace, note: Note) -> None:
        """`note`: takes the event of a warning."""
        self._rules, self._note = rules, note
        self._accounts: dict[str, _Account] = {}
        self._warned: set[str] = set()
        self._ticks = 0
        self.begin()

    def begin(self) -> None:
        """A tick in which everybody was asked."""
        self._ticks += 1
        self._half_s: float | None = None
        self._slow: list[str] = []

    def look(self, waited_s: float, barrier: Barrier) -> None:
        """Takes note of who has not answered after so many seconds."""
        if self._half_s is None and 2 * barrier.silent <= len(barrier.asked):
            self._half_s = waited_s
        slow = waited_s > self._rules.slow_s and not self._slow
        if slow and self._half_s is not None and waited_s > self._rules.slow_factor * self._half_s:
            self._slow = barrier.missing

    def overdrawn(self) -> list[tuple[str, str]]:
        """After the tick's last answer: the nodes it takes no more of, and why."""
        over = []
        for node in self._slow:
            name = node if node.startswith(LEADER) else node.partition(".")[0]
            before = self._accounts.get(name, _Account(0.0, self._ticks - 1))
            prompt = self._ticks - before.tick - 1
            slow = max(0.0, before.slow - prompt / self.FORGIVEN_TICKS) + 1.0
            self._accounts[name] = _Account(slow, self._ticks)
            text = f"{slow:.0f} replies took more than {self._rules.slow_s:g} s, and {self._rules.slow_factor:g} times "
            text += f"what half of the nodes took; `pace.slow_ticks` is {self._rules.slow_ticks}"
            if slow >= self._rules.slow_ticks:
                over.append((node, text))
            elif 2 * slow >= self._rules.slow_ticks and name not in self._warned:
                self._warned.add(name)
                log.warning("%s is slow: %s", node, text, extra={"peer": node, "reason": "slow"})
                self._note("slow", f"{node}: {text}")
        return over
