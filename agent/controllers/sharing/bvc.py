"""Buffered Voronoi cells: each UAV stays on its own side of the middle between it and each other UAV, less a buffer.

Zhou, Wang, Bandyopadhyay and Schwager, Fast, on-line collision avoidance for dynamic vehicles using buffered Voronoi
cells, IEEE Robotics and Automation Letters 2(2), 2017. The source plans with the vehicle's
dynamics. Here the velocity is limited, so that the UAV can stop at the edge of its cell.
"""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from meanflock import kernels
from meanflock.agent.controllers.base import Memory, Step
from meanflock.agent.controllers.cruise import acceleration_limit, limited
from meanflock.agent.controllers.sharing.base import Travelling, TravellingController
from meanflock.agent.controllers.sharing.nearby import (
    Closest,
    closest,
    closest_obstacles,
    stopping_speed,
    to_the_right,
    with_obstacles,
)
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Rows, States, Vectors

INFEASIBLE_M_S = 1e-6  # violation up to which a half-plane counts as satisfied


class BufferedVoronoi(TravellingController):
    """Buffered Voronoi cells, after Zhou, Wang, Bandyopadhyay and Schwager (2017).

    a = k_v (v_cell − v) + c0 (v − v_o); v_cell is nearest to the velocity of `cruise`, turned to the right by
    `right_bias`, of all velocities from which the UAV can stop within its cell.
    """

    name = "bvc"
    dimensions = (2, 3)
    diagnostics = ("infeasible", "unsent")
    stays_inside = True

    class Options(Travelling, frozen=True):
        """The options of `bvc`."""

        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 3.0
        radius_m: Annotated[float, Meta(gt=0, description="buffer, half of the distance that two UAVs keep, m")] = 0.45
        clearance_m: Annotated[
            float, Meta(ge=0, description="distance to keep from the edge of an obstacle, the floor and the ceiling, m")
        ] = 0.4
        right_bias: Annotated[
            float, Meta(ge=0, le=1, description="share of the cruise velocity that is added to its right")
        ] = 0.5
        speed_max_m_s: Annotated[float, Meta(gt=0, description="limit on the velocity chosen, m/s")] = 4.0
        neighbours: Annotated[int, Meta(ge=1, le=32, description="number of the closest UAVs that bound a cell")] = 10
        obstacles: Annotated[
            int, Meta(ge=1, le=32, description="number of the closest obstacles that bound a cell")
        ] = 4
        reach_m: Annotated[float, Meta(gt=0, description="distance beyond which a UAV bounds no cell, m")] = 15.0
        acceleration_max_m_s2: Annotated[
            float, Meta(gt=0, description="limit on ‖a‖ before drag, at most that of the vehicle, m/s²")
        ] = 6.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._limit = acceleration_limit(scenario, options.acceleration_max_m_s2)
        self._delay_s = scenario.dt + 1.0 / options.velocity_gain_1_s  # a tick, and the lag of the velocity

    def fly(self, memory: Memory, own: States, others: States) -> Step:
        options = self.options
        memory, preferred = self._travel.velocity(memory, own)
        preferred = to_the_right(preferred, options.right_bias)
        near = closest(own, others, memory["neighbour_uav"], options.reach_m, options.neighbours)
        normals, bounds = self._faces(near, options.radius_m, 0.5)
        if len(self._obstacles):
            solids, radii = closest_obstacles(own, self._obstacles, options.reach_m, options.obstacles)
            more, least = self._faces(solids, radii + options.clearance_m, 1.0)
            normals, bounds = with_obstacles(normals, bounds, more, least)
        if len(self._limits):
            distance = self._limits.seen(own)[0] - options.clearance_m
            normals, bounds = self._limits.added(normals, bounds, -stopping_speed(distance, self._limit, self._delay_s))
        velocity, missing = np.empty(preferred.shape), np.empty(len(own))
        kernels.nearest(np.ascontiguousarray(preferred), normals, bounds, options.speed_max_m_s, velocity, missing)
        acceleration = limited(options.velocity_gain_1_s * (velocity - state.velocity(own)), self._limit)
        return Step(memory, acceleration, (missing > INFEASIBLE_M_S)[:, None].astype(np.float64))

    def _faces(self, near: Closest, buffer: float | Rows, share: float) -> tuple[Vectors, Rows]:
        """Half-planes, in space half-spaces, n·v ≥ bound of velocities from which a row stops before the faces of its
        cell.

        Args:
            near: UAVs or obstacles near the M rows. buffer: distance of a row from a face, m; or (M, K). share:
                position of the face on the way to the other: 0.5 for a UAV, 1 for the centre of an obstacle.

        Returns:
            Normals (M, K, d), 0 in unused columns, and bounds (M, K), m/s.
        """
        length = np.sqrt(np.where(near.present, near.squared, 1.0))
        normals = np.where(near.present[..., None], near.away / length[..., None], 0.0)
        return normals, -stopping_speed(share * length - buffer, self._limit, self._delay_s)
