"""The floor and the ceiling of a flight in space, as half-spaces of commands or velocities."""

import numpy as np

from meanflock.agent.controllers.sharing.nearby import with_obstacles
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Rows, States, Vectors


class AltitudeLimits:
    """The L limits of altitude that the scenario sets, each a face that points to the side where UAVs may fly."""

    def __init__(self, scenario: Scenario) -> None:
        limits = np.array(scenario.space.limits).reshape(-1, 2)
        self._side, self._altitude = limits[:, 0], limits[:, 1]
        self._normals = np.zeros((1, len(limits), scenario.dimensions))
        self._normals[..., -1] = self._side

    def __len__(self) -> int:
        return len(self._side)

    def seen(self, own: States) -> tuple[Rows, Rows]:
        """Distances of rows (M, 6) from the limits, m, negative beyond, and speeds away from them, m/s; (M, L) each."""
        z, v_z = state.position(own)[:, -1:], state.velocity(own)[:, -1:]
        return self._side * (z - self._altitude), self._side * v_z

    def added(self, normals: Vectors, bounds: Rows, least: Rows) -> tuple[Vectors, Rows]:
        """The half-spaces with those of the limits, whose bounds are `least` (M, L), as `with_obstacles`."""
        return with_obstacles(normals, bounds, np.repeat(self._normals, len(least), axis=0), least)
