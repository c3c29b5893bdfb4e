"""Where another UAV is by now, from what it last sent: by its velocity, or by a plan that everybody knows."""

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
        """What is remembered, (S, 4), of states (S, 4) that UAVs (S,) sent in a tick."""

    def now(self, kept: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        """The states predicted for a tick, (M, 4, K), of what was kept, (M, 4, K), `age` (M, K) ticks ago.

        `uavs`: of whom; what it takes from an array (N, 4) is (K, 4), or (M, K, 4).
        """


class ConstantVelocity:
    """Everybody goes on as it was: r + v·age."""

    def __init__(self, dt: float) -> None:
        self._dt = dt

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        return states

    def now(self, kept: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        states = np.empty(kept.shape)
        np.multiply(kept[:, AXES:], (age * self._dt)[:, None], out=states[:, :AXES])
        states[:, :AXES] += kept[:, :AXES]
        states[:, AXES:] = kept[:, AXES:]
        return states


class AlongPlan:
    """Everybody comes back to a plan: s*(t) + (s − s*) at the time it was sent · e^(−age/τ)."""

    def __init__(self, plan: Callable[[int], States], dt: float, tau_s: float = 2.0) -> None:
        """`plan`: the states s* of all UAVs in a tick, (N, 4). `tau_s`: τ, in which a deviation falls to 1/e."""
        self._plan = plan
        # By age in ticks, down to nothing: where every number has its own, none depends on its place in an array.
        self._left = np.array([math.exp(-age * dt / tau_s) for age in range(math.ceil(40.0 * tau_s / dt) + 1)])

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        """See `Prediction`: the deviation from the plan."""
        return states - self._plan(tick)[uavs]

    def now(self, kept: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        states = kept * self._left[np.minimum(age, len(self._left) - 1)][:, None]
        states += np.swapaxes(self._plan(tick)[uavs], -1, -2)
        return states
