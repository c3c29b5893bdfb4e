"""Mean difference of velocities in a tick: over all pairs of UAVs, or over a sample of the pairs of a large swarm."""

from typing import NamedTuple

import numpy as np

from meanflock import kernels
from meanflock.swarm import state
from meanflock.swarm.seeds import generator

EXACT = 3000  # UAVs up to which all pairs are measured
SAMPLE = 65_536  # pairs that are measured of more UAVs


class SpeedDifference(NamedTuple):
    """Mean of ‖v_j − v_i‖, m/s, and its squared standard error, which is 0 over all pairs."""

    mean: float
    squared_error: float


def speed_difference(states: state.States, seed: int, tick: int) -> SpeedDifference:
    """The mean over all N² pairs of UAVs `(N, 4)` of ‖v_j − v_i‖.

    Of more than `EXACT` UAVs it is estimated, without bias, from `SAMPLE` pairs, which depend on seed and tick only.
    """
    n = len(states)
    if n <= EXACT:
        return SpeedDifference(kernels.alignment(states), 0.0)
    first, second = generator(seed, "alignment", tick).integers(n, size=(2, SAMPLE), dtype=np.int32)
    columns = np.ascontiguousarray(state.velocity(states).T)
    speeds = np.sqrt(state.squared([along.take(first) - along.take(second) for along in columns]))
    mean = float(np.add.reduce(speeds)) / SAMPLE
    speeds -= mean
    speeds *= speeds
    return SpeedDifference(mean, float(np.add.reduce(speeds)) / (SAMPLE * (SAMPLE - 1)))
