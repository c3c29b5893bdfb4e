"""Who takes part: the nodes of a run, the UAVs each holds, who leads, and who is still there."""

import math
from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.errors import MeanflockError
from meanflock.swarm.net.identity import LEADER
from meanflock.swarm.scenario import tables
from meanflock.swarm.wire.messages import Join

MAX_LEADERS = 8  # living at once; a standby is cheap, but not free
_LEADERS_PLACE = -1  # an agent has the places of its UAVs


class JoinRefused(MeanflockError):
    """A node cannot take part; the text says why. `for_now`: it could, if somebody else were lost."""

    def __init__(self, why: str, *, for_now: bool = False) -> None:
        super().__init__(why)
        self.for_now = for_now


@dataclass(eq=False)
class Member:
    """One node, from its admission until it is lost."""

    name: str
    role: str
    uavs: NDArray[np.intp]  # ascending; none for a leader
    since_s: float = 0.0  # when it was admitted, on the world's clock
    events: int = 0  # it wanted in the log
    ready: bool = False
    lost: bool = False

    def __post_init__(self) -> None:
        self.rows = len(self.uavs)
        self.places = self.uavs.tolist() if self.rows else [_LEADERS_PLACE]
        # Where its UAVs are among all: a slice, where it is one, costs a fraction of so many indices.
        first, end = (int(self.uavs[0]), int(self.uavs[-1]) + 1) if len(self.uavs) else (0, 0)
        self.place: slice | NDArray[np.intp] = slice(first, end) if end - first == len(self.uavs) else self.uavs


class Members:
    """The nodes of a run of N UAVs, by name. UAVs without an agent are free: from the start, or since it was lost.

    present: nodes that are not lost, in order of their UAVs, the leaders last.
    """

    def __init__(self, uavs: int, leaders: int, *, standbys: bool = True, rows_at_most: int | None = None) -> None:
        """`leaders`: how many must be there before take-off. `standbys`: whether more than one leader can be of use.
        `rows_at_most`: how many UAVs one agent may hold; None for as many as it offers.
        """
        self._by_name: dict[str, Member] = {}
        self.present: list[Member] = []  # replaced, never changed: other threads read it
        self._uavs, self._rows_at_most = uavs, rows_at_most
        self._free = np.arange(uavs)
        self._leaders, self._standbys = leaders, standbys
        self._lives: Counter[str] = Counter()
        self._admitted: dict[tuple[str, int], Member] = {}  # by role and token of their Join
        self._incumbent: str | None = None
        self._shut: dict[int, tuple[float, str]] = {}  # places that nobody may take, until when, and why
        self._rejoins: defaultdict[int, deque[int]] = defaultdict(deque)  # ticks, by place

    def admit(self, join: Join, now_s: float = 0.0) -> Member:
        """Gives a node its name and the UAVs it asks for, or the next free ones.

        Whoever comes after a node that was lost, or stands by for the leader, has the same name with a number behind
        it: what the old one may still say is then not mistaken for the new one's. A node that has not heard its answer
        and asks again, with the same token, is told the same.

        Raises:
            JoinRefused: no UAV is free, or not the one asked for; no further leader is needed; the role is unknown;
                the place is shut.
        """
        waiting = self._admitted.get((join.role, join.token)) if join.token else None
        if waiting is not None and not waiting.ready and not waiting.lost:
            return waiting
        if join.role == LEADER:
            if self._living(LEADER) and not self._standbys:
                raise JoinRefused("this run has a leader already, and no rounds that a standby could take over")
            if len(self._living(LEADER)) >= max(MAX_LEADERS, self._leaders):
                raise JoinRefused(f"this run has {MAX_LEADERS} leaders already", for_now=True)
            self._check_open([_LEADERS_PLACE], now_s)
            base, taken = LEADER, np.zeros(0, dtype=np.intp)
        elif join.role == "agent" and join.rows >= 1:
            taken = self._wanted(join, now_s)
            base = f"agent-{taken[0]}"
        else:
            raise JoinRefused(f"role {join.role!r} with {join.rows} UAVs: agents hold at least one, a leader none")
        self._free = np.setdiff1d(self._free, taken)
        self._lives[base] += 1
        name = base if self._lives[base] == 1 else f"{base}.{self._lives[base]}"
        member = self._by_name[name] = self._admitted[join.role, join.token] = Member(name, join.role, taken, now_s)
        self._sort()
        return member

    def lose(self, member: Member) -> None:
        """A node is gone; its UAVs are free for another."""
        member.lost = True
        self._sort()
        self._free = np.union1d(self._free, member.uavs)

    def rejoined(self, member: Member, tick: int, rules: tables.Pace) -> bool:
        """Counts that a node is back in flight. True where that was once too often: its places are shut for good."""
        too_often = False
        for place in member.places:
            ticks = self._rejoins[place]
            ticks.append(tick)
            while tick - ticks[0] > rules.rejoin_ticks:
                ticks.popleft()
            if len(ticks) >= rules.rejoins and place not in self._shut:
                too_often = True
        if too_often:
            why = f"joined again {rules.rejoins} times within {rules.rejoin_ticks} ticks, the most that "
            self.shut(member, math.inf, f"{why}`pace.rejoins` and `pace.rejoin_ticks` allow")
        return too_often

    def shut(self, member: Member, until_s: float, why: str) -> None:
        """Lets nobody take the places of a node until then."""
        for place in member.places:
            self._shut[place] = max(self._shut.get(place, (0.0, "")), (until_s, why))

    def lead(self) -> Member | None:
        """The leader that is elected among those that live and listen; the incumbent as long as it does."""
        self._incumbent = elect((member.name for member in self._living(LEADER) if member.ready), self._incumbent)
        return self._by_name.get(self._incumbent or "")

    def get(self, name: str) -> Member | None:
        """The node of that name."""
        return self._by_name.get(name)

    @property
    def complete(self) -> bool:
        """Whether every UAV has an agent that listens, and the leaders do where rounds need them."""
        led = len(self._living(LEADER)) >= self._leaders
        return led and not len(self._free) and all(member.ready for member in self.present)

    def missing(self) -> str:
        """What the swarm still waits for, in words."""
        waiting = []
        if len(self._free):
            waiting.append(f"{len(self._free)} UAVs without an agent")
        if absent := max(0, self._leaders - len(self._living(LEADER))):
            waiting.append("the leader" if self._leaders == 1 else f"{absent} of {self._leaders} leaders")
        waiting += [f"{member.name} to be ready" for member in self.present if not member.ready]
        return ", ".join(waiting)

    def _sort(self) -> None:
        alive = [member for member in self._by_name.values() if not member.lost]
        self.present = sorted(alive, key=lambda member: (member.role == LEADER, member.uavs[:1].tolist()))

    def _living(self, role: str) -> list[Member]:
        return [member for member in self._by_name.values() if member.role == role and not member.lost]

    def _check_open(self, places: Sequence[int], now_s: float) -> None:
        for place in places:
            until_s, why = self._shut.get(place, (0.0, ""))
            if until_s > now_s:
                who = "the leader" if place == _LEADERS_PLACE else f"the agent of UAV {place}"
                when = "for good" if until_s == math.inf else f"for {until_s - now_s:.0f} s"
                raise JoinRefused(f"refused {when}: {who} {why}", for_now=until_s < math.inf)

    def _wanted(self, join: Join, now_s: float) -> NDArray[np.intp]:
        if join.uav >= self._uavs:
            raise JoinRefused(f"UAV {join.uav}: this run has UAVs 0 to {self._uavs - 1}")
        if not len(self._free):
            raise JoinRefused("every UAV of this run has its agent already", for_now=True)
        rows = min(join.rows, self._rows_at_most or join.rows)
        if join.uav < 0:
            usable = [uav for uav in self._free.tolist() if self._shut.get(uav, (0.0, ""))[0] <= now_s]
            if not usable:
                self._check_open(self._free.tolist(), now_s)
            return np.array(usable[:rows], dtype=np.intp)
        wanted = np.arange(join.uav, min(join.uav + rows, self._uavs))
        if (taken := np.setdiff1d(wanted, self._free)).size:
            raise JoinRefused(f"UAV {taken[0]} has its agent already", for_now=True)
        self._check_open(wanted.tolist(), now_s)
        return wanted


def elect(living: Iterable[str], incumbent: str | None = None) -> str | None:
    """Who leads: the incumbent while it lives, then the lowest name among the `living`; None where nobody lives.

    All agreed on this beforehand, so nobody has to negotiate when the leader is gone; it depends on the set only.
    """
    names = set(living)
    return incumbent if incumbent in names else min(names, default=None)
