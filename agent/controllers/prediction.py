"""Prediction of another UAV's state from the last one it sent: at constant velocity, or along a plan known to all."""

import math
from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.state import AXES, Floats, States

Which: TypeAlias = Any  # an index of UAVs into (N, …): a slice, or an array of numbers


class Prediction(Protocol):
    """A rule of prediction. A row of a result depends on that row alone."""

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        """Returns the numbers to remember, (S, 4), of states (S, 4) that UAVs (S,) sent in a tick."""

    def now(self, remembered: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        """Returns the states predicted for a tick, (M, 4, K), from numbers of `keep`, (M, 4, K), `age` (M, K) ticks
        old.

        `uavs`: index of the UAVs; it selects (K, 4) or (M, K, 4) from an array (N, 4).
        """


class ConstantVelocity:
    """Prediction at constant velocity: r + v·age."""

    def __init__(self, dt: float) -> None:
        self._dt = dt

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        return states

    def now(self, remembered: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        states = np.empty(remembered.shape)
        np.multiply(remembered[:, AXES:], (age * self._dt)[:, None], out=states[:, :AXES])
        states[:, :AXES] += remembered[:, :AXES]
        states[:, AXES:] = remembered[:, AXES:]
        return states


class AlongPlan:
    """Prediction of a return to a plan: s*(t) + (s − s*)·e^(−age/τ), with s − s* at the time of sending."""

    def __init__(self, plan: Callable[[int], States], dt: float, tau_s: float = 2.0) -> None:
        """`plan`: the states s* of all UAVs in a tick, (N, 4). `tau_s`: τ, in which a deviation falls to 1/e."""
        self._plan = plan
        # By age in ticks. A table, because the bits of an array `exp` depend on the position in the array.
        self._left = np.array([math.exp(-age * dt / tau_s) for age in range(math.ceil(40.0 * tau_s / dt) + 1)])

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        """See `Prediction`: the deviation from the plan."""
        return states - self._plan(tick)[uavs]

    def now(self, remembered: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        states = remembered * self._left[np.minimum(age, len(self._left) - 1)][:, None]
        states += np.swapaxes(self._plan(tick)[uavs], -1, -2)
        return states
