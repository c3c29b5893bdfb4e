"""Optimal reciprocal collision avoidance: the velocity nearest to the preferred one that avoids collisions for τ
seconds if all UAVs choose theirs in the same way.

Van den Berg, Guy, Lin and Manocha, Reciprocal n-body collision avoidance, Robotics Research (ISRR), 2011. If no
velocity avoids all collisions, the largest violation is minimised, as by the third program of the source.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers.base import Memory, Step
from meanflock.agent.controllers.sharing.base import Travelling, TravellingController
from meanflock.agent.controllers.sharing.nearby import (
    Closest,
    closest,
    closest_obstacles,
    level,
    to_the_right,
    with_obstacles,
)
from meanflock.swarm import state
from meanflock.swarm.state import Rows, States, Vectors

INFEASIBLE_M_S = 1e-6  # violation up to which a half-plane counts as satisfied


class Orca(TravellingController):
    """Optimal reciprocal collision avoidance, after van den Berg, Guy, Lin and Manocha (2011).

    a = k_v (v_orca − v) + c0 (v − v_o); v_orca is nearest to the velocity of `cruise`, turned to the right by
    `right_bias`.
    """

    name = "orca"
    dimensions = (2, 3)
    diagnostics = ("infeasible", "unsent")
    stays_inside = True

    class Options(Travelling, frozen=True):
        """The options of `orca`."""

        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 4.0
        radius_m: Annotated[float, Meta(gt=0, description="combined radius of two UAVs, m")] = 0.9
        horizon_s: Annotated[float, Meta(gt=0, description="τ, how long a velocity avoids collisions, s")] = 3.0
        right_bias: Annotated[
            float, Meta(ge=0, le=1, description="share of the cruise velocity that is added to its right")
        ] = 0.3
        speed_max_m_s: Annotated[float, Meta(gt=0, description="limit on the velocity chosen, m/s")] = 4.0
        neighbours: Annotated[int, Meta(ge=1, le=32, description="number of the closest UAVs that are avoided")] = 10
        obstacles: Annotated[int, Meta(ge=1, le=32, description="number of the closest obstacles that are avoided")] = 4
        reach_m: Annotated[float, Meta(gt=0, description="distance beyond which a UAV is not avoided, m")] = 15.0

    def fly(self, memory: Memory, own: States, others: States) -> Step:
        memory, preferred = self._travel.velocity(memory, own)
        preferred = to_the_right(preferred, self.options.right_bias)
        velocity, missing = self.velocity(own, others, memory["neighbour_uav"], preferred)
        acceleration = self.options.velocity_gain_1_s * (velocity - state.velocity(own))
        return Step(memory, acceleration, (missing > INFEASIBLE_M_S)[:, None].astype(np.float64))

    def velocity(
        self, own: States, others: States, uavs: NDArray[np.integer], preferred: Vectors
    ) -> tuple[Vectors, Rows]:
        """Velocities chosen by rows (M, 2d), (M, d) m/s, and the largest violation of a half-plane, (M,) m/s.

        `others`: (M, N, 2d), states of all UAVs known to each row. `uavs`: (M,), the numbers of the rows.
        `preferred`: (M, d), the preferred velocities.
        """
        options, dt = self.options, self.scenario.dt
        near = closest(own, others, uavs, options.reach_m, options.neighbours)
        normals, bounds = half_planes(near, own, options.radius_m, options.horizon_s, dt, 0.5)
        if len(self._obstacles):
            solids, radii = closest_obstacles(own, self._obstacles, options.reach_m, options.obstacles)
            more, least = half_planes(solids, own, radii + 0.5 * options.radius_m, options.horizon_s, dt, 1.0)
            normals, bounds = with_obstacles(normals, bounds, more, least)
        if len(self._limits):
            distance = self._limits.seen(own)[0] - 0.5 * options.radius_m
            least = -distance / np.where(distance > 0.0, options.horizon_s, dt)
            normals, bounds = self._limits.added(normals, bounds, least)
        chosen, missing = np.empty(preferred.shape), np.empty(len(own))
        kernels.nearest(np.ascontiguousarray(preferred), normals, bounds, options.speed_max_m_s, chosen, missing)
        return chosen, missing


def half_planes(
    near: Closest, own: States, radius: float | Rows, horizon_s: float, dt: float, share: float
) -> tuple[Vectors, Rows]:
    """Half-planes n·v ≥ n·(v_own + share · u) of collision-free velocities: normals (M, K, d), 0 in unused columns, and
    bounds (M, K). In space they are half-spaces, with other last digits than in a plane.

    u is the least change of the relative velocity that takes it out of the velocity obstacle (their Eq. 2 to 5), a cone
    about −`away` cut off by a disc; for two that touch already, the obstacle is that
    of one tick.
    """
    if state.axes(own) != state.PLANE:
        return _half_spaces(near, own, radius, horizon_s, dt, share)
    x = -near.away[..., 0]
    y = -near.away[..., 1]
    v_x = near.closing[..., 0]
    v_y = near.closing[..., 1]
    squared = np.where(near.present, near.squared, 1.0)
    touching = squared <= radius * radius
    rate = np.where(touching, 1.0 / dt, 1.0 / horizon_s)
    # Relative to the centre of the disc that cuts the cone off.
    w_x, w_y = v_x - rate * x, v_y - rate * y
    length = np.sqrt(w_x * w_x + w_y * w_y)
    along = w_x * x + w_y * y
    disc = touching | ((along < 0.0) & (along * along > radius * radius * (length * length)))
    unit = np.where(length > 0.0, length, 1.0)
    # At the centre all directions are equal; take the one away from the other UAV.
    apart = np.sqrt(squared)
    out_x, out_y = np.where(length > 0.0, w_x / unit, -x / apart), np.where(length > 0.0, w_y / unit, -y / apart)
    # The legs of the cone, and the side on which the relative velocity is.
    leg = np.sqrt(np.where(touching, 0.0, squared - radius * radius))
    side = np.where(x * w_y - y * w_x > 0.0, 1.0, -1.0)
    leg_x, leg_y = side * (x * leg - side * y * radius) / squared, side * (y * leg + side * x * radius) / squared
    n_x, n_y = np.where(disc, out_x, -leg_y), np.where(disc, out_y, leg_x)
    off = np.where(disc, radius * rate - length, -(v_x * n_x + v_y * n_y))  # how far u leads along n
    bounds = n_x * own[:, None, 2] + n_y * own[:, None, 3] + share * off
    return np.where(near.present[..., None], np.stack([n_x, n_y], axis=-1), 0.0), bounds


def _half_spaces(
    near: Closest, own: States, radius: float | Rows, horizon_s: float, dt: float, share: float
) -> tuple[Vectors, Rows]:
    """The half-spaces of `half_planes`: the normal of the cone is in the plane of −`away` and the relative velocity."""
    towards, closing = -near.away, near.closing
    squared = np.where(near.present, near.squared, 1.0)
    apart = np.sqrt(squared)
    touching = squared <= radius * radius
    rate = np.where(touching, 1.0 / dt, 1.0 / horizon_s)
    # Relative to the centre of the ball that cuts the cone off.
    relative = closing - rate[..., None] * towards
    length, along = state.length(relative), state.inner(relative, towards)
    ball = touching | ((along < 0.0) & (along * along > radius * radius * (length * length)))
    unit = np.where(length > 0.0, length, 1.0)[..., None]
    out = np.where(length[..., None] > 0.0, relative / unit, -towards / apart[..., None])
    # Away from the axis of the cone; for a relative velocity along it, to the right, or along x if it is vertical.
    across = relative - (along / squared)[..., None] * towards
    right = level(state.SPACE, towards[..., 1], -towards[..., 0])
    right[..., 0] += (right == 0.0).all(axis=-1)
    across = np.where((state.length(across) > 0.0)[..., None], across, right)
    across = across / state.length(across)[..., None]
    sine = np.where(touching, 0.0, radius / apart)
    cosine = np.sqrt(np.maximum(1.0 - sine * sine, 0.0))
    edge = cosine[..., None] * across - (sine / apart)[..., None] * towards
    normals = np.where(ball[..., None], out, edge)
    off = np.where(ball, radius * rate - length, -state.inner(closing, normals))  # how far u leads along n
    bounds = state.inner(normals, state.velocity(own)[:, None]) + share * off
    return np.where(near.present[..., None], normals, 0.0), bounds
