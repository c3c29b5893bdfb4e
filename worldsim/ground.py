"""The ground of a flight in space, z = 0: no UAV is below it, and those that touch it are counted."""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Mask
from meanflock.swarm.stateful import Stateful


class Ground(Stateful):
    """The ground. A UAV that starts on it is counted only after it has risen above the collision radius.

    Attributes:
        is_there: whether the flight is in space.
        risen: (N,), UAVs that have been higher than the collision radius.
        touched: (N,), UAVs that came down to the ground after that, elsewhere than at their goal.
    """

    stored = ("risen", "touched")

    def __init__(self, scenario: Scenario) -> None:
        self.is_there = scenario.dimensions == state.SPACE
        self._radius = scenario.metrics.collision_radius
        self.risen = np.zeros(scenario.uavs, dtype=bool)
        self.touched = np.zeros(scenario.uavs, dtype=bool)

    def above(self, states: state.States) -> state.States:
        """States (N, 6), those below the ground put back to it: z = 0, v_z = 0, x and y unchanged."""
        below = states[:, 2] < 0.0
        if not np.count_nonzero(below):
            return states
        states = states.copy()
        states[below, 2] = states[below, 5] = 0.0
        return states

    def touch(self, states: state.States, arrived: Mask) -> NDArray[np.intp]:
        """Add the UAVs that are on the ground at the end of a tick; those that have `arrived`, (N,), may land.

        Returns:
            The UAVs that touch it for the first time.
        """
        height = states[:, 2]
        self.risen |= height > self._radius
        new = np.flatnonzero((height <= 0.0) & self.risen & ~self.touched & ~arrived)
        self.touched[new] = True
        return new
