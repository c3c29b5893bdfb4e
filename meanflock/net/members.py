"""The nodes of a run: the UAVs that each holds, the elected leader, and the places that are free or closed."""

import math
from collections import Counter, defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.topology.base import Role
from meanflock.net.access import LEADER
from meanflock.swarm.errors import MeanflockError
from meanflock.swarm.scenario import tables
from meanflock.swarm.wire.messages import Join
from meanflock.worldsim.crew import place_of

MAX_LEADERS = 8  # at the same time, standbys included
_LEADERS_PLACE = -1  # the places of an agent are its UAVs


class JoinRefused(MeanflockError):
    """A node cannot take part; the text says why.

    Attributes:
        for_now: it could if another node were lost. over: the run never needs it.
    """

    def __init__(self, reason: str, *, for_now: bool = False, over: bool = False) -> None:
        super().__init__(reason)
        self.for_now = for_now
        self.over = over


@dataclass(eq=False)
class Member:
    """One node, from its admission until it is lost."""

    name: str
    role: Role
    uavs: NDArray[np.intp]  # ascending; none for a leader
    since_s: float = 0.0  # when it was admitted, on the world's clock
    events: int = 0  # that it has sent
    read: int = 0  # number of the last letter that it was sent
    informed: bool = False  # whether a leader has the state of the aggregation rule
    ready: bool = False
    lost: bool = False

    def __post_init__(self) -> None:
        self.rows = len(self.uavs)
        self.places = self.uavs.tolist() if self.rows else [_LEADERS_PLACE]
        self.place = place_of(self.uavs)  # of its UAVs among all UAVs


class Members:
    """The nodes of a run of N UAVs, by name. A UAV without an agent is free.

    present: nodes that are not lost, in order of their UAVs, leaders last.
    """

    def __init__(
        self,
        uavs: int,
        leaders: int,
        *,
        standbys: bool = True,
        leaderless: bool = False,
        rows_at_most: int | None = None,
        groups: Sequence[NDArray[np.intp]] = (),
    ) -> None:
        """
        Args:
            leaders: how many must be there before take-off. standbys: whether further leaders are admitted.
            leaderless: whether no leader is ever admitted.
            rows_at_most: most UAVs of one agent; None for as many as it offers.
            groups: the UAVs, ascending, of each group of which an agent has UAVs of one only; none: there is one.
        """
        self._by_name: dict[str, Member] = {}
        self.present: list[Member] = []  # replaced, never changed, because other threads read it
        self._uavs = uavs
        self._rows_at_most = rows_at_most
        self._free = np.arange(uavs)
        self._group = np.zeros(uavs, dtype=np.intp)  # number of the group of each UAV
        for number, group in enumerate(groups):
            self._group[group] = number
        self._leaders = leaders
        self._standbys = standbys
        self._leaderless = leaderless
        self._lives: Counter[str] = Counter()
        self._admitted: dict[tuple[str, int], Member] = {}  # by role and token of their Join
        self._incumbent: str | None = None
        self._closed: dict[int, tuple[float, str]] = {}  # closed places: until when, and why
        self._rejoins: defaultdict[int, deque[int]] = defaultdict(deque)  # ticks, by place

    def admit(self, join: Join, now_s: float = 0.0) -> Member:
        """Give a node its name and the UAVs it asks for, or the next free ones.

        A node in the place of a lost one, or a standby leader, gets the same name with a number behind it, so that
        late messages of the old node are not taken for those of the new one. A node that asks again with the same
        token, because it got no answer, gets the same answer.

        Raises:
            JoinRefused: no UAV is free, or not the one asked for; no further leader is needed; the role is unknown;
                the place is shut.
        """
        waiting = self._admitted.get((join.role, join.token)) if join.token else None
        if waiting is not None and not waiting.ready and not waiting.lost:
            return waiting
        role: Role
        if join.role == LEADER:
            if self._leaderless:
                raise JoinRefused("no leader is needed: every UAV averages for itself", over=True)
            if self._living(LEADER) and not self._standbys:
                raise JoinRefused("this run has a leader already, and no rounds that a standby could take over")
            if len(self._living(LEADER)) >= max(MAX_LEADERS, self._leaders):
                raise JoinRefused(f"this run has {MAX_LEADERS} leaders already", for_now=True)
            self._check_open([_LEADERS_PLACE], now_s)
            role, base, taken = "leader", LEADER, np.zeros(0, dtype=np.intp)
        elif join.role == "agent" and join.rows >= 1:
            taken = self._wanted(join, now_s)
            role, base = "agent", f"agent-{taken[0]}"
        else:
            raise JoinRefused(f"role {join.role!r} with {join.rows} UAVs: agents hold at least one, a leader none")
        self._free = np.setdiff1d(self._free, taken)
        self._lives[base] += 1
        name = base if self._lives[base] == 1 else f"{base}.{self._lives[base]}"
        member = self._by_name[name] = self._admitted[join.role, join.token] = Member(name, role, taken, now_s)
        self._sort()
        return member

    def lose(self, member: Member) -> None:
        """Mark a node as lost and free its UAVs."""
        member.lost = True
        self._sort()
        self._free = np.union1d(self._free, member.uavs)

    def rejoined(self, member: Member, tick: int, rules: tables.Pace) -> bool:
        """Count that a node rejoined in flight; returns whether its places are now closed for good."""
        too_often = False
        for place in member.places:
            ticks = self._rejoins[place]
            ticks.append(tick)
            while tick - ticks[0] > rules.rejoin_ticks:
                ticks.popleft()
            if len(ticks) >= rules.rejoins and place not in self._closed:
                too_often = True
        if too_often:
            reason = f"joined again {rules.rejoins} times within {rules.rejoin_ticks} ticks, the most that "
            self.close_places(member, math.inf, f"{reason}`pace.rejoins` and `pace.rejoin_ticks` allow")
        return too_often

    def close_places(self, member: Member, until_s: float, reason: str) -> None:
        """Close the places of a node until a time."""
        for place in member.places:
            self._closed[place] = max(self._closed.get(place, (0.0, "")), (until_s, reason))

    def lead(self) -> Member | None:
        """The leader: the last one as long as it is ready, else the lowest name of those that are; None for none."""
        ready = [member.name for member in self._living(LEADER) if member.ready]
        if self._incumbent not in ready:
            self._incumbent = min(ready, default=None)
        return None if self._incumbent is None else self._by_name[self._incumbent]

    def get(self, name: str) -> Member | None:
        """The node of that name."""
        return self._by_name.get(name)

    @property
    def complete(self) -> bool:
        """Returns whether every UAV has an agent, there are enough leaders, and all of them are ready."""
        led = len(self._living(LEADER)) >= self._leaders
        return led and not len(self._free) and all(member.ready for member in self.present)

    def missing(self) -> str:
        """The nodes that are missing or not ready, in words."""
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
            until_s, reason = self._closed.get(place, (0.0, ""))
            if until_s > now_s:
                holder = "the leader" if place == _LEADERS_PLACE else f"the agent of UAV {place}"
                duration = "for good" if until_s == math.inf else f"for {until_s - now_s:.0f} s"
                raise JoinRefused(f"refused {duration}: {holder} {reason}", for_now=until_s < math.inf)

    def _wanted(self, join: Join, now_s: float) -> NDArray[np.intp]:
        if join.uav >= self._uavs:
            raise JoinRefused(f"UAV {join.uav}: this run has UAVs 0 to {self._uavs - 1}")
        if not len(self._free):
            raise JoinRefused("every UAV of this run has its agent already", for_now=True)
        rows = min(join.rows, self._rows_at_most or join.rows)
        if join.uav < 0:
            usable = [uav for uav in self._free.tolist() if self._closed.get(uav, (0.0, ""))[0] <= now_s]
            if not usable:
                self._check_open(self._free.tolist(), now_s)
            alike = np.array(usable, dtype=np.intp)
            return alike[self._group[alike] == self._group[alike[0]]][:rows]
        wanted = (join.uav + np.flatnonzero(self._group[join.uav :] == self._group[join.uav]))[:rows]
        if (taken := np.setdiff1d(wanted, self._free)).size:
            raise JoinRefused(f"UAV {taken[0]} has its agent already", for_now=True)
        self._check_open(wanted.tolist(), now_s)
        return wanted
