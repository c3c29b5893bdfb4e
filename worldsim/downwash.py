"""Downwash in space: the wake of a UAV pushes UAVs below it down.

The force on a UAV Δz below and Δxy aside is −c₁ (r/4Δz)² exp(−½ (Δxy/(c₂Δz + c₃))²), the model of gym-pybullet-drones
(Panerati and others, Learning to fly, IROS 2021; `BaseAviary._downwash`), which was fitted to Crazyflies at the Dynamic
Systems Lab in Toronto. As there, a UAV 10 m or more aside feels nothing.

The formula grows without bound near the rotor. The momentum of a wake is the weight of its UAV, so the force of a wake
is at most that: it is reached about 0.5 m below.
"""

from typing import NamedTuple

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Mask, States, Vectors

_GRAVITY_M_S2 = 9.81
_REACH_M = 10.0  # aside


class Wake(NamedTuple):
    """The wake of a craft for which the force has been fitted."""

    mass_kg: float
    radius_m: float  # r, of a propeller
    c1_N: float  # a unit
    c2: float
    c3_m: float


WAKES = {"crazyflie": Wake(mass_kg=0.027, radius_m=0.0231348, c1_N=2267.18, c2=0.16, c3_m=-0.11)}


class Downwash:
    """The accelerations of UAVs by the wakes of others; all pairs are compared, so time and memory grow with N²."""

    def __init__(self, scenario: Scenario) -> None:
        self._wake = WAKES.get(scenario.wind.downwash)

    def added(self, gust: Vectors | None, states: States, waiting: Mask | None) -> Vectors | None:
        """A gust (N, d) m/s² with the wakes of the UAVs at `states` (N, 2d); the gust itself without downwash.

        UAVs that are `waiting`, (N,), have no wake. Wakes are added in the order of the UAVs.
        """
        if self._wake is None:
            return gust
        flown = np.zeros((len(states), state.axes(states))) if gust is None else gust.copy()
        place = state.position(states)
        below = place[:, None, 2] - place[:, 2]  # of the column's UAV
        x, y = (place[:, None, axis] - place[:, axis] for axis in range(2))
        aside_squared = x * x + y * y
        feels = (below > 0.0) & (aside_squared < _REACH_M * _REACH_M)
        if waiting is not None:
            feels &= ~waiting[:, None]
        above, uav = np.nonzero(feels)
        pushes = acceleration(self._wake, below[above, uav], aside_squared[above, uav])
        flown[:, 2] -= np.bincount(uav, pushes, len(states))
        return flown


def acceleration(wake: Wake, below_m: state.Rows, aside_squared_m2: state.Rows) -> state.Rows:
    """Downward acceleration of UAVs so far below another and so far aside, (P,) m/s²."""
    share = wake.radius_m / (4.0 * np.maximum(below_m, wake.radius_m))  # nearer, the bound holds
    width = wake.c2 * below_m + wake.c3_m
    narrow = np.maximum(width * width, 1e-12)  # as printed, the wake has no width at one distance
    force = wake.c1_N * share * share * np.exp(-0.5 * aside_squared_m2 / narrow)
    return np.minimum(force / wake.mass_kg, _GRAVITY_M_S2)
