"""Flocking of Vásárhelyi et al. (Optimized flocking of autonomous drones in confined environments, Science Robotics 3,
2018): a preferred velocity, repulsion from close UAVs, and friction with UAVs that approach faster than braking allows.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Memory, Step
from meanflock.agent.controllers.cruise import limited
from meanflock.agent.controllers.sharing.base import Travelling, TravellingController
from meanflock.agent.controllers.sharing.nearby import NOWHERE_M, Near, edges, near, summed
from meanflock.swarm import state
from meanflock.swarm.state import Floats, Rows, States, Vectors


def braking(distance_m: Rows, slope_1_s: float, acceleration: float) -> Rows:
    """Braking curve D(r, a, p), their Eq. 3: the speed from which a UAV can stop within r; linear near the end. (P,)
    m/s.
    """
    positive = np.maximum(distance_m, 0.0)
    linear = positive * slope_1_s
    root = np.sqrt(np.maximum(2.0 * acceleration * positive - (acceleration / slope_1_s) ** 2, 0.0))
    return np.where(linear < acceleration / slope_1_s, linear, root)


class Vasarhelyi(TravellingController):
    """Flocking with repulsion and friction, after Vásárhelyi and others (2018).

    a = (v_d − v)/τ + c0 (v − v_o), v_d = v_ref + repulsion + friction; v_ref is that of `cruise`.
    """

    name = "vasarhelyi"
    dimensions = (2, 3)

    class Options(Travelling, frozen=True):
        """The options of `vasarhelyi`, by their names in the source where it has them."""

        p_rep_1_s: Annotated[float, Meta(ge=0, description="strength of the repulsion, 1/s")] = 2.0
        r0_rep_m: Annotated[float, Meta(gt=0, description="range of the repulsion, m")] = 1.3
        c_frict: Annotated[float, Meta(ge=0, le=1, description="strength of the friction")] = 0.5
        v_frict_m_s: Annotated[float, Meta(ge=0, description="difference of velocities without friction, m/s")] = 0.1
        r0_frict_m: Annotated[float, Meta(ge=0, description="distance at which braking ends, m")] = 0.5
        a_frict_m_s2: Annotated[float, Meta(gt=0, description="deceleration of the braking curve, m/s²")] = 0.5
        p_frict_1_s: Annotated[float, Meta(gt=0, description="slope of the linear part of the curve, 1/s")] = 1.5
        range_m: Annotated[float, Meta(gt=0, description="distance beyond which a UAV is ignored, m")] = 25.0
        v_shill_m_s: Annotated[float, Meta(ge=0, description="speed of `shill` agents away from an obstacle, m/s")] = (
            4.0
        )
        r0_shill_m: Annotated[float, Meta(ge=0, description="distance from an obstacle at which braking ends, m")] = 0.5
        a_shill_m_s2: Annotated[float, Meta(gt=0, description="deceleration of that braking curve, m/s²")] = 4.0
        p_shill_1_s: Annotated[float, Meta(gt=0, description="slope of the linear part of that curve, 1/s")] = 3.0
        v_max_m_s: Annotated[float, Meta(gt=0, description="limit on v_d, m/s")] = 4.0
        tau_s: Annotated[float, Meta(gt=0, description="τ, time constant of the velocity, s")] = 0.4

    def fly(self, memory: Memory, own: States, others: States) -> Step:
        memory, velocity = self._travel.velocity(memory, own)
        pairs = near(own, others, memory["neighbour_uav"], self.options.range_m, self._matters)
        velocity += summed(pairs.row, self._push(pairs), len(own))
        if len(self._obstacles):
            velocity += self._off_obstacles(own)
        velocity = limited(velocity, self.options.v_max_m_s)
        return Step(memory, (velocity - state.velocity(own)) / self.options.tau_s)

    def _matters(self, squared: Floats, difference_squared: Floats) -> NDArray[np.bool_]:
        """Mask of the pairs that can have repulsion or friction. √(2ar − a²/p²) never exceeds D(r, a, p)."""
        options = self.options
        least = (
            2.0 * options.a_frict_m_s2 * (np.sqrt(squared) - options.r0_frict_m)
            - (options.a_frict_m_s2 / options.p_frict_1_s) ** 2
        )
        np.maximum(least, options.v_frict_m_s**2, out=least)
        return (difference_squared > least) | (squared < options.r0_rep_m**2)

    def _off_obstacles(self, own: States) -> Vectors:
        """Friction with `shill` agents, which move away from the nearest points of all obstacles: their Eq. 5 and 6,
        (M, d) m/s.
        """
        options = self.options
        edge, away, closing = edges(own, self._obstacles)
        relative = [v - options.v_shill_m_s * along for v, along in zip(closing, away, strict=True)]
        difference = np.sqrt(state.squared(relative))
        allowed = braking(edge - options.r0_shill_m, options.p_shill_1_s, options.a_shill_m_s2)
        share = np.maximum(difference - allowed, 0.0) / np.maximum(difference, NOWHERE_M)
        return -np.stack([np.add.reduce(share * v, axis=1) for v in relative], axis=-1)

    def _push(self, pairs: Near) -> Vectors:
        """Repulsion (their Eq. 1) and friction (Eq. 2, 4) of pairs, (P, d) m/s."""
        options = self.options
        repulsion = options.p_rep_1_s * np.maximum(options.r0_rep_m - pairs.distance, 0.0)
        difference = np.sqrt(state.dot(pairs.closing, pairs.closing))
        allowed = np.maximum(
            options.v_frict_m_s, braking(pairs.distance - options.r0_frict_m, options.p_frict_1_s, options.a_frict_m_s2)
        )
        friction = options.c_frict * np.maximum(difference - allowed, 0.0) / np.maximum(difference, NOWHERE_M)
        return repulsion[:, None] * pairs.away - friction[:, None] * pairs.closing
