"""Limits of altitude of a flight in space: UAVs that go beyond them are counted, and fly on."""

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Mask
from meanflock.swarm.stateful import Stateful


class Altitude(Stateful):
    """The floor and the ceiling, as far as they are set: L limits. The floor counts for a UAV once it has risen above.

    Attributes:
        limits: of `Space.limits`, with their sides.
        risen: (N,), UAVs that have been above the floor.
        beyond: (N, L), UAVs that were beyond a limit before they arrived.
    """

    stored = ("risen", "beyond")

    def __init__(self, scenario: Scenario) -> None:
        self.limits = scenario.space.limits
        self.risen = np.zeros(scenario.uavs, dtype=bool)
        self.beyond = np.zeros((scenario.uavs, len(self.limits)), dtype=bool)

    def leave(self, states: state.States, arrived: Mask) -> list[tuple[int, int]]:
        """Add the UAVs that are beyond a limit at the end of a tick, except those that have `arrived`, (N,).

        Returns:
            Pairs (UAV, number of the limit) of UAVs that are beyond a limit for the first time.
        """
        sides, places = np.array(self.limits).T
        inside = sides * (states[:, 2, None] - places)
        is_floor = sides > 0.0
        self.risen |= (inside > 0.0).all(axis=1, where=is_floor)
        counts = ~arrived[:, None] & (self.risen[:, None] | ~is_floor)
        new = (inside < 0.0) & counts & ~self.beyond
        self.beyond |= new
        return [(uav, limit) for uav, limit in np.argwhere(new).tolist()]
