"""Groups of a flight in tables, pictures and names: number and name of the group of each UAV, name of a run."""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.mission import Mission
from meanflock.swarm.scenario import Scenario


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


def run_name(flown: Scenario, mission: str | None = None) -> str:
    """Name of a run, by controller and seed: `mfgfl-hf-s1`; by its mission if its groups fly several controllers.

    `mission`: name of the scenario; None: it has none.
    """
    methods = {group.method or flown.method for group in flown.groups} or {flown.method}
    return f"{methods.pop() if len(methods) == 1 else mission or 'groups'}-s{flown.seed}"
