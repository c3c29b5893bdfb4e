"""The filter of exponential control barrier functions: what a controller commands, as little changed as keeps apart.

Wang, Ames and Egerstedt, Safety Barrier Certificates for Collisions-Free Multirobot Systems, IEEE T-RO 33, 2017; the
exponential form for a barrier of relative degree two is that of Nguyen and Sreenath, ACC 2016. With h = ‖Δr‖² − D² and
both poles at −k, ḧ + 2kḣ + k²h ≥ 0 is one half-plane of accelerations a pair, of which each of the two takes half; an
obstacle takes no part, so that all of it is the UAV's.
"""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers.base import Controller, Options
from meanflock.agent.controllers.cruise import against_the_air
from meanflock.agent.controllers.filtered import Filter, Floats
from meanflock.agent.controllers.sharing.nearby import Closest, closest, closest_discs, with_obstacles
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Plane, Rows, States

INFEASIBLE_M_S2 = 1e-6  # what may be missing of a half-plane that is still called kept


class Ecbf(Filter):
    """Exponential control barrier functions: keeps every two UAVs, and every UAV and obstacle, apart.

    Of all commands that do, the one nearest to the controller's.

    What is limited to `acceleration_max_m_s2` is the motion, drag and mean wind as known beforehand taken off and added
    again; so a controller that wants more is limited even where nobody is near. Where not everything can be kept, the
    least is given up that can be, and `infeasible` is 1.
    """

    name = "ecbf"
    columns = ("infeasible",)

    class Options(Options, frozen=True):
        """The options of `ecbf`."""

        distance_m: Annotated[
            float, Meta(gt=0, description="D, how far apart to stay; below the spacing that a formation flies, m")
        ] = 0.8
        rate_1_s: Annotated[float, Meta(gt=0, description="k, how fast the distance may shrink to D, 1/s")] = 4.0
        neighbours: Annotated[int, Meta(ge=1, le=32, description="of the closest UAVs, so many are kept off")] = 10
        reach_m: Annotated[float, Meta(gt=0, description="who is farther is not looked at, m")] = 6.0
        clearance_m: Annotated[float, Meta(ge=0, description="how far from the edge of an obstacle to stay, m")] = 0.3
        obstacle_rate_1_s: Annotated[float, Meta(gt=0, description="k of obstacles, 1/s")] = 1.5
        obstacles: Annotated[int, Meta(ge=1, le=32, description="of the closest obstacles, so many are kept off")] = 4
        acceleration_max_m_s2: Annotated[float, Meta(gt=0, description="limit on ‖dv/dt‖, m/s²")] = 3.0

    def __init__(self, options: Any, scenario: Scenario, inner: Controller) -> None:
        super().__init__(options, scenario, inner)
        self._discs = mission.obstacles(scenario)

    def admit(self, own: States, others: States, uavs: NDArray[np.integer], wanted: Plane) -> tuple[Plane, Floats]:
        """See `Filter.admit`."""
        options = self.options
        motion = np.ascontiguousarray(wanted - against_the_air(self.scenario, own), dtype=np.float64)
        near = closest(own, others, uavs, options.reach_m, options.neighbours)
        normals, bounds = half_planes(near, options.rate_1_s, options.distance_m, 0.5)
        if len(self._discs):
            discs, radii = closest_discs(own, self._discs, options.reach_m, options.obstacles)
            more, least = half_planes(discs, options.obstacle_rate_1_s, radii + options.clearance_m, 1.0)
            normals, bounds = with_obstacles(normals, bounds, more, least)
        admitted, missing = np.empty_like(motion), np.empty(len(own))
        kernels.nearest(motion, normals, bounds, options.acceleration_max_m_s2, admitted, missing)
        changed = (admitted != motion).any(axis=1, keepdims=True)
        infeasible = (missing > INFEASIBLE_M_S2)[:, None].astype(np.float64)
        return np.where(changed, wanted + (admitted - motion), wanted), infeasible


def half_planes(near: Closest, rate: float, distance: float | Rows, share: float) -> tuple[Plane, Rows]:
    """Normals (M, K, 2) and bounds (M, K) of Δr·a ≥ share · (−‖Δv‖² − 2kΔr·Δv − ½k²(‖Δr‖² − D²)), over ‖Δr‖; no normal
    where there is nobody."""
    away, closing = near.away, near.closing
    along = away[..., 0] * closing[..., 0] + away[..., 1] * closing[..., 1]
    speed = closing[..., 0] * closing[..., 0] + closing[..., 1] * closing[..., 1]
    bounds = -share * (speed + 2.0 * rate * along + 0.5 * rate * rate * (near.squared - distance * distance))
    length = np.sqrt(np.where(near.there, near.squared, 1.0))
    return np.where(near.there[..., None], away / length[..., None], 0.0), bounds / length
