"""Groups of a flight as tables and pictures name them: the number and the name of the group of each UAV."""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.mission import Mission


def numbers(flown: Mission) -> NDArray[np.intp]:
    """Number of the group of each UAV, (N,), from 0; 0 without groups."""
    if not flown.groups:
        return np.zeros(flown.uavs, dtype=np.intp)
    return np.repeat(np.arange(len(flown.groups)), [group.count for group in flown.groups])


def uav_names(flown: Mission) -> list[str]:
    """Names of all UAVs: `UAV 3`, with groups `UAV 3, couriers`."""
    if not flown.groups:
        return [f"UAV {uav}" for uav in range(flown.uavs)]
    return [f"UAV {uav}, {flown.groups[number].name}" for uav, number in enumerate(numbers(flown).tolist())]
