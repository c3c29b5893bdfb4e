"""Filters by control barrier functions: the acceleration nearest to the command that keeps every pair apart.

Wang, Ames and Egerstedt, Safety Barrier Certificates for Collisions-Free Multirobot Systems, IEEE T-RO 33, 2017. A
barrier h ≥ 0 of a pair gives one half-plane of accelerations, of which each UAV of the pair takes half. An obstacle
takes no part, so the UAV takes all of its half-plane. The floor and the ceiling of a flight in space are such, too.

`ecbf` has h = ‖Δr‖² − D², whose second derivative contains the acceleration (exponential form: Nguyen and Sreenath, ACC
2016). `braking` has the barrier of the source: the closing speed is at most the speed from which the pair can stop.
"""

from abc import abstractmethod
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller
from meanflock.agent.controllers.cruise import acceleration_limit, against_the_air
from meanflock.agent.controllers.filtered import Filter
from meanflock.agent.controllers.sharing.altitude import AltitudeLimits
from meanflock.agent.controllers.sharing.nearby import (
    Closest,
    Obstacles,
    closest,
    closest_obstacles,
    stopping_slope,
    stopping_speed,
    with_obstacles,
)
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Rows, States, Vectors

INFEASIBLE_M_S2 = 1e-6  # violation up to which a half-plane counts as satisfied

Distance = Annotated[float, Meta(gt=0, description="D, distance to keep; below the spacing that a formation flies, m")]
Rate = Annotated[float, Meta(gt=0, description="k, rate at which a barrier may shrink, 1/s")]


class BarrierOptions(base.Options, frozen=True):
    """Options of every filter with barriers."""

    distance_m: Distance = 0.8
    rate_1_s: Rate = 4.0
    neighbours: Annotated[int, Meta(ge=1, le=32, description="number of the closest UAVs that are avoided")] = 10
    reach_m: Annotated[float, Meta(gt=0, description="distance beyond which a UAV is not avoided, m")] = 6.0
    clearance_m: Annotated[
        float, Meta(ge=0, description="distance to keep from the edge of an obstacle, the floor and the ceiling, m")
    ] = 0.3
    obstacle_rate_1_s: Annotated[float, Meta(gt=0, description="k of obstacles, floor and ceiling, 1/s")] = 1.5
    obstacles: Annotated[int, Meta(ge=1, le=32, description="number of the closest obstacles that are avoided")] = 4
    acceleration_max_m_s2: Annotated[
        float, Meta(gt=0, description="limit on ‖dv/dt‖, at most that of the vehicle, m/s²")
    ] = 6.0


class HalfPlaneFilter(Filter):
    """Base class of these filters: override `half_planes` and `face`.

    The limit `acceleration_max_m_s2` is on the motion: drag and mean wind, as known before take-off, are subtracted and
    added again. So a controller that commands more is limited even if no UAV is near. If no acceleration satisfies all
    half-planes, the largest violation is the least possible, and `infeasible` is 1.
    """

    columns = ("infeasible",)
    dimensions = (2, 3)
    Options = BarrierOptions

    def __init__(self, options: Any, scenario: Scenario, inner: Controller) -> None:
        super().__init__(options, scenario, inner)
        self._obstacles = Obstacles(scenario)
        self._limits = AltitudeLimits(scenario)
        self._limit = acceleration_limit(scenario, options.acceleration_max_m_s2)

    @abstractmethod
    def half_planes(self, near: Closest, rate: float, distance: float | Rows, share: float) -> tuple[Vectors, Rows]:
        """Half-planes (in space half-spaces) n·a ≥ bound of accelerations of the rows.

        Args:
            near: UAVs or obstacles near the M rows. rate: k, 1/s. distance: D, m; or (M, K). share: the row's share of
                a half-plane, 0.5 for UAVs and 1 for obstacles.

        Returns:
            Normals (M, K, d), 0 in unused columns, and bounds (M, K), m/s².
        """
        raise NotImplementedError

    @abstractmethod
    def face(self, distance: Rows, speed: Rows, rate: float) -> Rows:
        """Bounds n·a ≥ bound, (M, L) m/s², of the rows before L flat faces with the normals n.

        Args:
            distance: (M, L), m, to keep positive. speed: its derivative, m/s. rate: k, 1/s.
        """
        raise NotImplementedError

    def admit(self, own: States, others: States, uavs: NDArray[np.integer], wanted: Vectors) -> tuple[Vectors, Floats]:
        """Returns the acceleration nearest to `wanted` that satisfies all half-planes, and `infeasible`."""
        options = self.options
        motion = np.ascontiguousarray(wanted - against_the_air(self.scenario, own), dtype=np.float64)
        near = closest(own, others, uavs, options.reach_m, options.neighbours)
        normals, bounds = self.half_planes(near, options.rate_1_s, options.distance_m, 0.5)
        if len(self._obstacles):
            solids, radii = closest_obstacles(own, self._obstacles, options.reach_m, options.obstacles)
            more, least = self.half_planes(solids, options.obstacle_rate_1_s, radii + options.clearance_m, 1.0)
            normals, bounds = with_obstacles(normals, bounds, more, least)
        if len(self._limits):
            distance, speed = self._limits.seen(own)
            least = self.face(distance - options.clearance_m, speed, options.obstacle_rate_1_s)
            normals, bounds = self._limits.added(normals, bounds, least)
        admitted, missing = np.empty_like(motion), np.empty(len(own))
        kernels.nearest(motion, normals, bounds, self._limit, admitted, missing)
        changed = (admitted != motion).any(axis=1, keepdims=True)
        infeasible = (missing > INFEASIBLE_M_S2)[:, None].astype(np.float64)
        return np.where(changed, wanted + (admitted - motion), wanted), infeasible


class Ecbf(HalfPlaneFilter):
    """Exponential control barrier functions: keep every two UAVs, and every UAV and obstacle, apart.

    Of all commands with ḧ + 2kḣ + k²h ≥ 0 for each h = ‖Δr‖² − D², the nearest to the controller's.
    """

    name = "ecbf"

    class Options(BarrierOptions, frozen=True):
        """The options of `ecbf`."""

        distance_m: Distance = 1.1
        rate_1_s: Rate = 3.0

    def half_planes(self, near: Closest, rate: float, distance: float | Rows, share: float) -> tuple[Vectors, Rows]:
        """ḧ + 2kḣ + k²h ≥ 0 of each pair, solved for the acceleration, see `HalfPlaneFilter`."""
        away, closing = near.away, near.closing
        along, speed = state.inner(away, closing), state.inner(closing, closing)
        bounds = -share * (speed + 2.0 * rate * along + 0.5 * rate * rate * (near.squared - distance * distance))
        length = np.sqrt(np.where(near.present, near.squared, 1.0))
        return np.where(near.present[..., None], away / length[..., None], 0.0), bounds / length

    def face(self, distance: Rows, speed: Rows, rate: float) -> Rows:
        """ḧ + 2kḣ + k²h ≥ 0 with h = distance, see `HalfPlaneFilter`."""
        return -rate * (2.0 * speed + rate * distance)


class Braking(HalfPlaneFilter):
    """Barriers with the braking distance: no pair closes faster than it can stop, one tick of delay included.

    Of all commands with ḣ + kh ≥ 0 for each h = v_stop(‖Δr‖ − D) + ‖Δr‖˙, the nearest to the controller's. v_stop is
    the speed from which a pair stops within a distance v·t + v²/2a at the limit of acceleration a, if it begins to
    brake after t: one tick, and `reaction_s` in addition.
    """

    name = "braking"

    class Options(BarrierOptions, frozen=True):
        """The options of `braking`."""

        reaction_s: Annotated[float, Meta(ge=0, description="time before a UAV brakes, beside one tick, s")] = 0.0

    def half_planes(self, near: Closest, rate: float, distance: float | Rows, share: float) -> tuple[Vectors, Rows]:
        """ḣ + kh ≥ 0 of each pair, solved for the acceleration, see `HalfPlaneFilter`."""
        length = np.sqrt(np.where(near.present, near.squared, 1.0))
        normals = np.where(near.present[..., None], near.away / length[..., None], 0.0)
        closing = near.closing
        along, across_squared = state.inner(normals, closing), state.cross_squared(normals, closing)
        deceleration = self._limit / share  # both UAVs of a pair brake
        delay_s = self.scenario.dt + self.options.reaction_s
        speed = stopping_speed(length - distance, deceleration, delay_s)
        slope = stopping_slope(length - distance, deceleration, delay_s)
        bounds = -share * (rate * (speed + along) + slope * along + across_squared / length)
        return normals, bounds

    def face(self, distance: Rows, speed: Rows, rate: float) -> Rows:
        """ḣ + kh ≥ 0 with h = v_stop(distance) + speed, see `HalfPlaneFilter`."""
        delay_s = self.scenario.dt + self.options.reaction_s
        stopping = stopping_speed(distance, self._limit, delay_s)
        slope = stopping_slope(distance, self._limit, delay_s)
        return -(rate * (stopping + speed) + slope * speed)
