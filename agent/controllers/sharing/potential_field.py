"""The artificial potential field of Khatib (Real-time obstacle avoidance for manipulators and mobile robots,
International Journal of Robotics Research 5(1), 1986): attraction to the goal at a limited speed, repulsion by near
objects.

The objects are other UAVs, as discs at their predicted positions, and the obstacles of the mission.
"""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from meanflock.agent.controllers.base import Memory, Step
from meanflock.agent.controllers.cruise import acceleration_limit, limited
from meanflock.agent.controllers.sharing.base import Travelling, TravellingController
from meanflock.agent.controllers.sharing.nearby import edges, near, summed
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Rows, States, Vectors


class PotentialField(TravellingController):
    """Artificial potential fields, after Khatib (1986).

    a = k_v (v_ref − v) + Σ η (1/ρ − 1/ρ0)/ρ² ∇ρ + c0 (v − v_o), ρ the distance from an edge; ‖·‖ is limited.
    """

    name = "potential-field"
    dimensions = (2, 3)

    class Options(Travelling, frozen=True):
        """The options of `potential-field`, by their names in the source where it has them."""

        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 1.0
        eta_m3_s2: Annotated[float, Meta(ge=0, description="η, strength of the repulsion by UAVs, m³/s²")] = 1.0
        rho0_m: Annotated[float, Meta(gt=0, description="ρ0, range of the repulsion by UAVs, m")] = 2.0
        radius_m: Annotated[
            float, Meta(ge=0, description="radius of a UAV, subtracted from distances to UAVs and obstacles, m")
        ] = 0.35
        obstacle_eta_m3_s2: Annotated[
            float, Meta(ge=0, description="η, strength of the repulsion by obstacles, m³/s²")
        ] = 10.0
        obstacle_rho0_m: Annotated[float, Meta(gt=0, description="ρ0, range of the repulsion by obstacles, m")] = 3.0
        acceleration_max_m_s2: Annotated[
            float, Meta(gt=0, description="limit on ‖a‖ before drag, at most that of the vehicle, m/s²")
        ] = 6.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._limit = acceleration_limit(scenario, options.acceleration_max_m_s2)

    def fly(self, memory: Memory, own: States, others: States) -> Step:
        options = self.options
        memory, velocity = self._travel.velocity(memory, own)
        acceleration = options.velocity_gain_1_s * (velocity - state.velocity(own))
        pairs = near(own, others, memory["neighbour_uav"], options.rho0_m + options.radius_m)
        force = repulsion(pairs.distance - options.radius_m, options.rho0_m, options.eta_m3_s2, self._limit)
        acceleration += summed(pairs.row, force[:, None] * pairs.away, len(own))
        if len(self._obstacles):
            acceleration += self._off_obstacles(own)
        return Step(memory, limited(acceleration, self._limit))

    def _off_obstacles(self, own: States) -> Vectors:
        """Repulsion of rows by all obstacles, (M, d) m/s²."""
        options = self.options
        edge, away, _ = edges(own, self._obstacles)
        force = repulsion(edge - options.radius_m, options.obstacle_rho0_m, options.obstacle_eta_m3_s2, self._limit)
        return np.stack([np.add.reduce(force * along, axis=1) for along in away], axis=-1)


def repulsion(rho_m: Rows, rho0_m: float, eta: float, most: float) -> Rows:
    """η (1/ρ − 1/ρ0)/ρ², his Eq. 20, of distances (…,) from an edge; 0 beyond ρ0, and `most` m/s² where it is more."""
    rho = np.maximum(rho_m, 1e-3 * rho0_m)
    return np.minimum(eta * np.maximum(1.0 / rho - 1.0 / rho0_m, 0.0) / (rho * rho), most)
