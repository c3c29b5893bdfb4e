"""Schedule of the rounds: when each hop of a round transmits and who takes part, known to all nodes beforehand."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.plan import Plan
from meanflock.federation.topology.base import Hop
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator
from meanflock.swarm.state import NO_UAV, contains
from meanflock.swarm.wire.messages import FrameKind

_DRAWN_AHEAD, _UAVS_AHEAD = 128, 2**16  # rounds, and UAVs in them, at most: some 5 ms and half a MiB


class Schedule:
    """The rounds k = 1, 2 … of a flight; none for methods that share no model.

    Attributes:
        hops: of every round, in order.
        period: ticks between two rounds, n0; 0 without rounds.
        gathers: whether a global model comes in several fragments, and is taken when the round ends.
        spreads: whether a global model is transmitted over several ticks or again, so its receivers are counted later.
    """

    def __init__(self, plan: Plan, uavs: NDArray[np.intp] | None = None) -> None:
        """`uavs`: (M,) ascending, those that `rows` speaks of; None for none."""
        self._scenario = scenario = plan.scenario
        self._members, self._participants = scenario.members, scenario.participants
        self._uavs = NO_UAV if uavs is None else uavs
        self.hops: tuple[Hop, ...] = plan.hops
        self.period = plan.period_ticks if self.hops else 0
        self._phases = {hop.after % self.period for hop in self.hops}
        self._over = 0  # ticks from the opening of a round until all of a global model that spreads has arrived
        by_radio = bool(self.hops) and not self.hops[-1].is_local
        self.gathers = by_radio and self.hops[-1].codec.count > 1
        self.spreads = self.gathers or (by_radio and scenario.federation.retries > 0)
        if self.spreads:
            attempts = 1 + scenario.federation.retries
            self._over = self.hops[-1].after + attempts * self.hops[-1].attempt_ticks
            self._phases.add(self._over % self.period)

    def is_busy(self, tick: int) -> bool:
        """Returns whether any hop may transmit in this tick."""
        return self.period > 0 and tick % self.period in self._phases

    def opens(self, tick: int) -> int:
        """The round that opens in this tick (tick = k·n0), or 0."""
        return tick // self.period if self.period and tick > 0 and tick % self.period == 0 else 0

    def number(self, hop: Hop, tick: int) -> int:
        """The round whose `hop` transmits in this tick, when all earlier mail has arrived or is lost; or 0."""
        return self.opens(tick - hop.after)

    def ends(self, tick: int) -> int:
        """The round whose global model has arrived in this tick, in fragments or again, or is lost; or 0."""
        return self.opens(tick - self._over) if self._over else 0

    def closes(self, tick: int) -> int:
        """The round whose last hop transmits in this tick, or 0."""
        return self.number(self.hops[-1], tick) if self.hops else 0

    def sent(self, label: FrameKind, number: int, tick: int) -> Hop | None:
        """The hop that transmitted the frames of a label and round that arrive in this tick; None for none."""
        age = self.age(number, tick)
        return next((hop for hop in reversed(self.hops) if hop.label == label and hop.after < age), None)

    def age(self, number: int, tick: int) -> int:
        """Ticks since a round opened."""
        return tick - number * self.period

    def open_round(self, tick: int) -> int:
        """The round whose mail may arrive in this tick, or whose last hop transmits; or 0."""
        if not self.period:
            return 0
        number, age = divmod(tick - 1, self.period)
        return number if number > 0 and age < self.hops[-1].after else 0

    def participants(self, number: int) -> NDArray[np.intp]:
        """𝒩_h of a round: N_h UAVs, ascending."""
        return self._members[_drawn(self._scenario.seed, len(self._members), self._participants, number)]

    def rows(self, number: int) -> NDArray[np.intp]:
        """The places of the participants of a round among `uavs`, ascending."""
        return np.flatnonzero(contains(self.participants(number), self._uavs))

    def draw_ahead(self) -> None:
        """Draws the participants of the flight's rounds, or of the first of very many, while nobody waits."""
        if not self.period:
            return
        most = min(_DRAWN_AHEAD, _UAVS_AHEAD // self._participants, self._scenario.max_ticks // self.period)
        for number in range(1, most + 1):
            self.participants(number)


def drawn(scenario: Scenario, number: int) -> NDArray[np.intp]:
    """The participants of a round of a scenario, ascending."""
    members = scenario.members
    return members[_drawn(scenario.seed, len(members), scenario.participants, number)]


@lru_cache(maxsize=_DRAWN_AHEAD)  # processes that are forked from one have those of their flight already
def _drawn(seed: int, members: int, participants: int, number: int) -> NDArray[np.intp]:
    """The places of the participants of a round among the members, ascending; not to be written to."""
    draw = generator(seed, "participants", number)
    found = np.sort(draw.choice(members, participants, replace=False))
    found.flags.writeable = False
    return found
