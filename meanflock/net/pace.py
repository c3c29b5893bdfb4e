"""Pace: which nodes are lost because they delay the flight tick after tick."""

import logging
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from meanflock.net.barrier import Barrier
from meanflock.net.members import LEADER, Member
from meanflock.swarm.events import FlightEvent, NodeIsSlow
from meanflock.swarm.scenario import tables

log = logging.getLogger("meanflock.world")


class Verdict(NamedTuple):
    """A node that must be lost, the reason, and for how many seconds no other node may take its place."""

    node: str
    reason: str
    out_s: float = 0.0


class _SlowReplies(NamedTuple):
    slow: float  # slow replies, less those forgiven since
    tick: int  # of the last one


class _Waits:
    """Sum of the waits for one node within a sliding window."""

    GRAIN_S = 1.0  # waits that end within so long of each other share an entry

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._entries: deque[tuple[float, float]] = deque()  # time and duration
        self.sum_s = 0.0

    def add(self, now: float, waited_s: float) -> None:
        """Add a wait that ended now."""
        if self._entries and now - self._entries[-1][0] < self.GRAIN_S:
            begin, before_s = self._entries.pop()
            self._entries.append((begin, before_s + waited_s))
        else:
            self._entries.append((now, waited_s))
        while now - self._entries[0][0] > self._window_s:
            self._entries.popleft()
        self.sum_s = sum(wait_s for _, wait_s in self._entries)


class DelayRules:
    """Rules that lose a node which delays the flight tick after tick, although it always replies.

    Two quantities count, for each node: its slow replies, and the time that all others waited for it alone. A node is
    warned at half of what the scenario's table `pace` allows, and lost at all of it.

    A reply is slow if it takes longer than `slow_s` and than `slow_factor` times what half of the nodes took. The
    world looks ten times a second. One slow reply is forgiven for every `FORGIVEN_TICKS` ticks without one.

    The wait for a node alone begins with the last reply but one, but not before `ORDINARY` times what half of the
    nodes took: where all nodes are slow, no single one is to blame. An agent may take `wait_share` of the window, its
    share of the UAVs, or one barrier, whichever is longest. This rule excludes the leader, because no other node does
    its work. A swarm's only agent is excluded from both rules, and so are an agent while a UAV of it trains, and a
    leader that no other can replace.

    An agent that rejoins keeps its account. Each standby leader has its own.
    """

    FORGIVEN_TICKS = 100
    ORDINARY = 2.0

    def __init__(self, rules: tables.Pace, news: list[FlightEvent], patience_s: float) -> None:
        """`news`: warnings are appended. `patience_s`: how long a tick waits for a node before it is lost."""
        self._rules = rules
        self._news = news
        self._patience_s = patience_s
        self._accounts: dict[str, _SlowReplies] = {}
        self._waits: dict[str, _Waits] = {}
        self._warned: set[str] = set()
        self.begin(0)

    def begin(self, tick: int, unhurried: Collection[str] = ()) -> None:
        """Begin a tick in which all nodes have been asked. `unhurried`: nodes that may take as long as a training."""
        self._tick = tick
        self._unhurried = unhurried
        self._half_s: float | None = None  # what half of the nodes took
        self._slow: list[str] = []
        self._verdicts: list[Verdict] = []

    def look(self, waited_s: float, barrier: Barrier) -> None:
        """Note which nodes have not replied after so many seconds."""
        if self._half_s is None and 2 * barrier.silent <= len(barrier.asked):
            self._half_s = waited_s
        slow = waited_s > self._rules.slow_s and not self._slow
        if slow and self._half_s is not None and waited_s > self._rules.slow_factor * self._half_s:
            agents = _agents(barrier)
            self._slow = [
                name
                for name in barrier.missing
                if [member.name for member in agents] != [name] and name not in self._unhurried
            ]

    def charge(self, waited_s: float, now: float, barrier: Barrier) -> None:
        """Add the time that all others waited for one agent to its account, after the last reply of a tick.

        `waited_s`: since all nodes were asked, without the time in which this machine stood still.
        """
        if len(barrier.settled) < 2:
            return
        *others, (settled, last) = barrier.settled
        half_s = others[len(others) // 2][0] - barrier.asked_at
        since = max(others[-1][0], barrier.asked_at + self.ORDINARY * half_s)
        alone_s = min(settled - since, waited_s)
        if alone_s > 0.0 and last.rows and last.name not in self._unhurried:
            agents = {member.name: member.rows for member in (*_agents(barrier), last)}
            share = max(self._rules.wait_share, last.rows / sum(agents.values()))
            if share < 1.0:
                self._enter(last, alone_s, now, share)

    def overdrawn(self) -> list[Verdict]:
        """The nodes that must be lost, after the last reply of a tick."""
        for node in self._slow:
            name = _account(node)
            before = self._accounts.get(name, _SlowReplies(0.0, self._tick - 1))
            prompt = self._tick - before.tick - 1
            slow = max(0.0, before.slow - prompt / self.FORGIVEN_TICKS) + 1.0
            self._accounts[name] = _SlowReplies(slow, self._tick)
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
            self._news.append(NodeIsSlow(self._tick, node, text))


def _agents(barrier: Barrier) -> list[Member]:
    return [member for member in barrier.asked.values() if member.rows]


def _account(node: str) -> str:
    """Name of the account of a node: that of its place, as `agent-3` for `agent-3.2`; a leader's own name."""
    return node if node.startswith(LEADER) else node.partition(".")[0]
