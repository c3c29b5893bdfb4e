"""How close the UAVs of a swarm come to each other in a tick. Over all pairs, exact."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.swarm import state
from meanflock.swarm.scenario import Metrics

_ROOM = 64  # pairs there is room for at first, besides one for each UAV


class Pairs(NamedTuple):
    """Close pairs of one tick.

    near: pairs i < j within the hazard radius at the end of the tick.
    touching: (K, 2), ascending: the pairs i < j that came within the collision radius during the tick.
    nearest_m: the least closest approach of any pair, or the given bound if that is less.
    """

    near: int
    touching: NDArray[np.intp]
    nearest_m: float


def pairs(metrics: Metrics, before: state.States, after: state.States, nearest_m: float) -> Pairs:
    """Measures a tick in which everyone moves straight from `before` to `after`, both `(N, 4)`.

    A UAV with NaN in `before` approaches nobody; one with NaN in `after` is left out. Closest approaches above
    `nearest_m` are of no interest.
    """
    radii = (metrics.hazard_radius, metrics.collision_radius)
    found = np.empty((_ROOM + len(after), 2), dtype=np.intp)
    near, count, nearest_m = kernels.pairs(before, after, *radii, nearest_m, found)
    if count > len(found):
        found = np.empty((count, 2), dtype=np.intp)
        kernels.pairs(before, after, *radii, nearest_m, found)
    return Pairs(near, found[:count], nearest_m)
