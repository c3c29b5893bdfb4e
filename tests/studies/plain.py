"""A plain point mass, in scenarios of whoever asks."""

from typing import Any

import numpy as np

from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.vehicles.point_mass import PointMass


def moved(flown: Scenario, states: np.ndarray, command: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """One tick of the point mass."""
    return PointMass(PointMass.Options(), flown).step(states, {}, command, noise)[0]


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, settings, **{"method": "mfg", **options})
