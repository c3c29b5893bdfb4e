"""How well the swarm flies as a flock: alignment, risk, collisions. Over all pairs, exact."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swarm import state
from swarm.scenario import Metrics

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Pairs:
    """One instant of a swarm of N, leading axes free.

    speed_difference: mean over all N² pairs of ‖v_j − v_i‖, m/s (the integrand of φ_A).
    near: pairs i < j within the hazard radius. colliding: (..., N, N) bool, i < j within the collision radius.
    """

    speed_difference: Floats
    near: NDArray[np.intp]
    colliding: NDArray[np.bool_]


def pairs(metrics: Metrics, states: state.States) -> Pairs:
    """Measures all pairs of `states`, `(..., N, 4)`."""
    n = states.shape[-2]
    x, y, vx, vy = (states[..., k] for k in (state.X, state.Y, state.VX, state.VY))

    def squared(first: Floats, second: Floats) -> Floats:
        along = first[..., :, None] - first[..., None, :]
        across = second[..., :, None] - second[..., None, :]
        along *= along
        across *= across
        along += across
        return along

    distance = squared(x, y)
    speeds = np.sqrt(squared(vx, vy))
    near = (distance <= metrics.hazard_radius**2).sum(axis=(-2, -1))
    colliding = distance < metrics.collision_radius**2
    total = speeds.reshape(*speeds.shape[:-2], n * n).sum(axis=-1)
    return Pairs(total / n**2, (near - n) // 2, np.triu(colliding, 1))
