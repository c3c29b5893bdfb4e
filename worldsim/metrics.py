"""How well the swarm flies as a flock: alignment, risk, collisions. Over all pairs, exact."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.swarm import state
from meanflock.swarm.scenario import Metrics

_MOST = 64  # colliding pairs there is room for at first


class Pairs(NamedTuple):
    """One instant of a swarm of N.

    speed_difference: mean over all N² pairs of ‖v_j − v_i‖, m/s (the integrand of φ_A).
    near: pairs i < j within the hazard radius.
    colliding: (K, 2), ascending: the pairs i < j within the collision radius.
    nearest_m: the least distance of any two; infinite where there are not two.
    """

    speed_difference: float
    near: int
    colliding: NDArray[np.intp]
    nearest_m: float


def pairs(metrics: Metrics, states: state.States) -> Pairs:
    """Measures all pairs of `states`, `(N, 4)`."""
    found = np.empty((_MOST, 2), dtype=np.intp)
    mean, near, count, nearest = kernels.pairs(states, metrics.hazard_radius, metrics.collision_radius, found)
    if count > len(found):
        found = np.empty((count, 2), dtype=np.intp)
        kernels.pairs(states, metrics.hazard_radius, metrics.collision_radius, found)
    return Pairs(mean, near, found[:count], nearest)
