"""Who keeps the flight waiting: a node that is slow in tick after tick is lost, though it answers every time."""

import logging
from collections import deque
from typing import NamedTuple

from meanflock.swarm.scenario import tables
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.members import LEADER, Member
from meanflock.worldsim.reporter import Note

log = logging.getLogger("meanflock.world")


class Verdict(NamedTuple):
    """A node that is to be lost, and for how long its UAVs stay without another."""

    node: str
    why: str
    out_s: float = 0.0


class _Account(NamedTuple):
    slow: float  # replies, less what was forgiven since
    tick: int  # of the last of them


class _Waits:
    """How long the others waited for one node within a window that ends now."""

    GRAIN_S = 1.0  # waits that begin within so long of each other are one entry

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._entries: deque[tuple[float, float]] = deque()  # when, and for how long
        self.sum_s = 0.0

    def add(self, now: float, waited_s: float) -> None:
        """Adds a wait that ended now."""
        if self._entries and now - self._entries[-1][0] < self.GRAIN_S:
            begun, before_s = self._entries.pop()
            self._entries.append((begun, before_s + waited_s))
        else:
            self._entries.append((now, waited_s))
        while now - self._entries[0][0] > self._window_s:
            self._entries.popleft()
        self.sum_s = sum(wait_s for _, wait_s in self._entries)


class Pace:
    """Counts slow replies, each node for itself, and the time that all others wait for one agent alone. A node is
    warned of at half of what it may have, and lost at all of it.

    A reply is slow beyond `slow_s` and `slow_factor` times what half of the nodes that were asked took; looked at is
    ten times a second. One slow reply is forgiven for every `FORGIVEN_TICKS` without one.

    The others wait for an agent alone from the last reply but one on, but not before `ORDINARY` times what half of the
    nodes took: where all are slow, nobody in particular is. An agent may cost `wait_share` of the window, its share of
    the UAVs, or one barrier, whichever is most. The leader is not judged by this: nobody else has its work. The only
    agent is judged by neither.

    The lives of an agent have one account; leaders that stand by each their own.
    """

    FORGIVEN_TICKS = 100
    ORDINARY = 2.0

    def __init__(self, rules: tables.Pace, note: Note, patience_s: float) -> None:
        """`note`: takes the event of a warning. `patience_s`: how long a tick waits for a node before it is lost."""
        self._rules, self._note, self._patience_s = rules, note, patience_s
        self._accounts: dict[str, _Account] = {}
        self._waits: dict[str, _Waits] = {}
        self._warned: set[str] = set()
        self._ticks = 0
        self.begin()

    def begin(self) -> None:
        """A tick in which everybody was asked."""
        self._ticks += 1
        self._half_s: float | None = None
        self._slow: list[str] = []
        self._verdicts: list[Verdict] = []

    def look(self, waited_s: float, barrier: Barrier) -> None:
        """Takes note of who has not answered after so many seconds."""
        if self._half_s is None and 2 * barrier.silent <= len(barrier.asked):
            self._half_s = waited_s
        slow = waited_s > self._rules.slow_s and not self._slow
        if slow and self._half_s is not None and waited_s > self._rules.slow_factor * self._half_s:
            agents = _agents(barrier)
            self._slow = [name for name in barrier.missing if [member.name for member in agents] != [name]]

    def charge(self, waited_s: float, now: float, barrier: Barrier) -> None:
        """After the tick's last answer: puts the time that all others waited for one agent alone on its account.

        `waited_s`: since everybody was asked, without the time in which this machine stood still.
        """
        if len(barrier.settled) < 2:
            return
        *others, (settled, last) = barrier.settled
        half_s = others[len(others) // 2][0] - barrier.asked_at
        since = max(others[-1][0], barrier.asked_at + self.ORDINARY * half_s)
        alone_s = min(settled - since, waited_s)
        if alone_s > 0.0 and last.rows:
            agents = {member.name: member.rows for member in (*_agents(barrier), last)}
            share = max(self._rules.wait_share, last.rows / sum(agents.values()))
            if share < 1.0:
                self._enter(last, alone_s, now, share)

    def overdrawn(self) -> list[Verdict]:
        """After the tick's last answer: the nodes it takes no more of."""
        for node in self._slow:
            name = _account(node)
            before = self._accounts.get(name, _Account(0.0, self._ticks - 1))
            prompt = self._ticks - before.tick - 1
            slow = max(0.0, before.slow - prompt / self.FORGIVEN_TICKS) + 1.0
            self._accounts[name] = _Account(slow, self._ticks)
            text = f"{slow:.0f} replies took more than {self._rules.slow_s:g} s, and {self._rules.slow_factor:g} times "
            text += f"what half of the nodes took; `pace.slow_ticks` is {self._rules.slow_ticks}"
            if slow >= self._rules.slow_ticks:
                self._verdicts.append(Verdict(node, text))
            elif 2 * slow >= self._rules.slow_ticks:
                self._warn(node, text)
        return self._verdicts

    def _enter(self, member: Member, alone_s: float, now: float, share: float) -> None:
        window_s = self._rules.wait_window_s
        waits = self._waits.setdefault(_account(member.name), _Waits(window_s))
        waits.add(now, alone_s)
        allowed_s = max(share * window_s, self._patience_s)
        text = f"the others waited {waits.sum_s:.1f} s of the last {window_s:g} s for it alone; {allowed_s:g} s is the "
        text += f"most, by `pace.wait_share` {self._rules.wait_share:g}"
        if waits.sum_s > allowed_s:
            self._verdicts.append(Verdict(member.name, text, window_s))
        elif 2 * waits.sum_s > allowed_s:
            self._warn(member.name, text)

    def _warn(self, node: str, text: str) -> None:
        if (name := _account(node)) not in self._warned:
            self._warned.add(name)
            log.warning("%s is slow: %s", node, text, extra={"peer": node, "reason": "slow"})
            self._note("slow", f"{node}: {text}")


def _agents(barrier: Barrier) -> list[Member]:
    return [member for member in barrier.asked.values() if member.rows]


def _account(node: str) -> str:
    return node if node.startswith(LEADER) else node.partition(".")[0]
