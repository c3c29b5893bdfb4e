"""When a federated round happens and who takes part: known to all beforehand, so no invitation is paid for."""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.ascending import contains
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator
from meanflock.swarm.wire.messages import FrameKind

_DRAWN_AT_ONCE = 8  # rounds: the first draw of a process among many finds nothing in the caches, the others do
_DRAWN_AHEAD, _UAVS_AHEAD = 128, 2**16  # rounds, and UAVs in them, at most: some 5 ms and half a MiB


class Rounds:
    """The calendar of the rounds k = 1, 2 … of a scenario; without rounds for methods that share no model."""

    def __init__(self, scenario: Scenario, uavs: NDArray[np.intp] | None = None) -> None:
        """`uavs`: whose rows are wanted, ascending; None for nobody's."""
        self._scenario = scenario
        self._uavs = np.zeros(0, dtype=np.intp) if uavs is None else uavs
        self._period = scenario.period_ticks if scenario.declared.is_federated else 0
        self._hop_ticks, self._open_ticks = scenario.hop_ticks, scenario.round_ticks
        self._relays = scenario.federation.clusters > 1
        self._drawn: dict[int, tuple[NDArray[np.intp], NDArray[np.intp]]] = {}

    def opens(self, tick: int) -> int:
        """The round whose uploads are sent in this tick (tick = k·n0), or 0."""
        return tick // self._period if self._period and tick and tick % self._period == 0 else 0

    def relays(self, tick: int) -> int:
        """The round whose heads hand on their means in this tick, when every upload has arrived or is lost, or 0."""
        return self.opens(tick - self._hop_ticks) if self._relays and tick > self._hop_ticks else 0

    def closes(self, tick: int) -> int:
        """The round that is averaged in this tick, when all that is sent to the leader has arrived or is lost, or 0."""
        return self.opens(tick - self._open_ticks) if tick > self._open_ticks else 0

    def of(self, kind: FrameKind, tick: int) -> int:
        """The round that frames of a kind sent in this tick belong to, or 0."""
        match kind:
            case FrameKind.UPLOAD:
                return self.opens(tick)
            case FrameKind.RELAY:
                return self.relays(tick)
            case FrameKind.GLOBAL:
                return self.closes(tick)
        return 0

    def is_open(self, tick: int) -> bool:
        """Whether the leader may have anything to do in this tick: the first upload comes a tick after it is sent."""
        return bool(self._period) and tick > self._period and (tick - 1) % self._period < self._open_ticks

    def participants(self, number: int) -> NDArray[np.intp]:
        """𝒩_h of a round: N_h UAVs, ascending."""
        return self._draws(number)[0]

    def rows(self, number: int) -> NDArray[np.intp]:
        """The places of those that take part in a round among the `uavs`, ascending."""
        return self._draws(number)[1]

    def draw_ahead(self) -> None:
        """Draws who takes part in the rounds of the flight, or in the first of very many, while nobody waits."""
        if not self._period:
            return
        most = max(_DRAWN_AT_ONCE, min(_DRAWN_AHEAD, _UAVS_AHEAD // self._scenario.participants))
        self._draw_next(1, min(most, self._scenario.max_ticks // self._period))

    def _draws(self, number: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        if number not in self._drawn:
            self._draw_next(number, _DRAWN_AT_ONCE)
        return self._drawn[number]

    def _draw_next(self, first: int, count: int) -> None:
        self._drawn = {}
        for number in range(first, first + count):
            draw = generator(self._scenario.seed, "participants", number)
            drawn = np.sort(draw.choice(self._scenario.uavs, self._scenario.participants, replace=False))
            rows = np.flatnonzero(contains(drawn, self._uavs))
            drawn.flags.writeable = rows.flags.writeable = False
            self._drawn[number] = drawn, rows
