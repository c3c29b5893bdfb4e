"""When a federated round happens and who takes part: known to all beforehand, so no invitation is paid for."""

import numpy as np
from numpy.typing import NDArray

from swarm.messages import FrameKind
from swarm.scenario import Scenario
from swarm.seeds import generator


def delivery_ticks(scenario: Scenario, slots: NDArray[np.int64]) -> NDArray[np.intp]:
    """Ticks until a message that took so many slots is delivered: max(1, ⌈slots θ/dt⌉), same shape.

    A quotient that is a whole number but for rounding counts as that number.
    """
    ticks = slots * scenario.radio.coherence_time_s / scenario.dt
    return np.maximum(1, np.ceil(ticks * (1.0 - 1e-9))).astype(np.intp)


class Rounds:
    """The calendar of the rounds k = 1, 2 … of a scenario; without rounds for methods that share no model."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._period = scenario.period_ticks if scenario.method.is_federated else 0
        longest = np.array(scenario.radio.latency_threshold_slots)
        self._horizon = int(delivery_ticks(scenario, longest))

    def opens(self, tick: int) -> int:
        """The round whose uploads are sent in this tick (tick = k·n0), or 0."""
        return tick // self._period if self._period and tick and tick % self._period == 0 else 0

    def closes(self, tick: int) -> int:
        """The round that is averaged in this tick, when every upload has arrived or is lost, or 0."""
        return self.opens(tick - self._horizon) if tick > self._horizon else 0

    def of(self, kind: FrameKind, tick: int) -> int:
        """The round that frames of a kind sent in this tick belong to, or 0."""
        if kind == FrameKind.UPLOAD:
            return self.opens(tick)
        return self.closes(tick) if kind == FrameKind.GLOBAL else 0

    def is_open(self, tick: int) -> bool:
        """Whether the leader may have anything to do in this tick."""
        return bool(self._period) and tick >= self._period and tick % self._period <= self._horizon

    def participants(self, number: int) -> NDArray[np.intp]:
        """𝒩_h of a round: N_h UAVs, ascending."""
        draw = generator(self._scenario.seed, "participants", number)
        return np.sort(draw.choice(self._scenario.uavs, self._scenario.participants, replace=False))
