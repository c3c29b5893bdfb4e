"""Motion and its cost, by whatever vehicle the scenario names: here, and nowhere else, its results are checked."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import plugins, state
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.failures import FAILURES, last_line
from meanflock.swarm.kept import check_again, check_kept
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.base import Hidden, Vehicle

BOUND = 1e9  # a million kilometres or km/s: no metric is left worth having


class Moved(NamedTuple):
    """One tick. states: (N, 4). hidden: the vehicle's. power: (N,), W. diverged: (K,), UAVs put back, at rest."""

    states: state.States
    hidden: Hidden
    power: state.Rows
    diverged: NDArray[np.intp]


_NOBODY = np.zeros(0, dtype=np.intp)


class Physics:
    """The vehicle of a scenario."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises BadInput where the scenario's vehicle is not installed or its options do not fit."""
        chosen = scenario.vehicle
        self._name = chosen.model
        self._vehicle: Vehicle = plugins.create("vehicle", chosen.model, chosen.options, scenario.flown())

    def init(self, uavs: int) -> Hidden:
        """The hidden state of so many UAVs at take-off; BadInput where the vehicle cannot begin."""
        try:
            return self._begun(uavs)
        except RunFailed as error:
            raise BadInput(str(error)) from error

    def _begun(self, uavs: int) -> Hidden:
        hidden = self._asked("init", uavs)
        try:
            check_kept("hidden", hidden, uavs)
        except (TypeError, ValueError) as error:
            raise self._wrong(f"`init`: {error}") from error
        for name, part in hidden.items():
            self._check_finite(f"hidden[{name!r}] of `init`", part)
        return dict(hidden)

    def __call__(
        self,
        states: state.States,
        hidden: Hidden,
        acceleration: state.Plane,
        noise: state.Plane,
        waiting: NDArray[np.bool_] | None = None,
    ) -> Moved:
        """One tick; the arguments of `Vehicle.step`, and who stays as it is, (N,), and spends nothing.

        Raises:
            RunFailed: the vehicle raised, or gave what cannot be; the message names it and the UAV.
        """
        for array in (states, *hidden.values()):
            array.flags.writeable = False
        answer = self._asked("step", states, dict(hidden), acceleration, noise)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise self._wrong("`step` must give states and hidden state")
        moved, changed = answer
        self._check_shape("states", moved, states.shape, states.dtype)
        self._check_hidden(hidden, changed)
        moved, diverged = np.ascontiguousarray(moved), _NOBODY
        if not np.maximum.reduce(np.abs(moved), axis=None) < BOUND:
            far = ~(np.abs(moved) < BOUND).all(axis=-1)  # NaN is below nothing
            sane = np.isfinite(acceleration).all(axis=-1)
            self._check_finite("states", moved[far & sane], np.flatnonzero(far & sane))
            moved, diverged = moved.copy(), np.flatnonzero(far)
            moved[far] = states[far]
            moved[far, state.VELOCITY] = 0.0
            acceleration = np.where(far[:, None], 0.0, acceleration)
            changed = {name: _put_back(part, hidden[name], diverged) for name, part in changed.items()}
        power = self._asked("power", moved, changed, acceleration)
        self._check("power", power, (len(states),), states.dtype)
        if waiting is not None:
            still = np.flatnonzero(waiting)
            moved, power = _put_back(moved, states, still), np.where(waiting, 0.0, power)
            changed = {name: _put_back(part, hidden[name], still) for name, part in changed.items()}
            diverged = diverged[~waiting[diverged]]
        return Moved(moved, changed, power, diverged)

    def _asked(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self._vehicle, method)(*arguments)
        except FAILURES as error:
            raise self._wrong(f"`{method}` failed: {last_line(error)}") from error

    def _check_hidden(self, before: Hidden, after: Any) -> None:
        try:
            check_again("hidden", after, before)
        except (TypeError, ValueError) as error:
            raise self._wrong(str(error)) from error
        for name, part in after.items():
            self._check_finite(f"hidden[{name!r}]", part)

    def _check(self, what: str, array: Any, shape: tuple[int, ...], dtype: np.dtype) -> None:
        self._check_shape(what, array, shape, dtype)
        self._check_finite(what, array)

    def _check_shape(self, what: str, array: Any, shape: tuple[int, ...], dtype: np.dtype) -> None:
        if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
            found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise self._wrong(f"{what}: {found}, expected {dtype} {shape}")

    def _check_finite(self, what: str, array: NDArray, uavs: NDArray[np.intp] | None = None) -> None:
        if np.count_nonzero(finite := np.isfinite(array)) < array.size:
            row = int(np.flatnonzero(~finite.reshape(len(array), -1).all(axis=-1))[0])
            uav = row if uavs is None else uavs[row]
            raise self._wrong(f"{what} of UAV {uav}: {array[row]} is not finite")

    def _wrong(self, what: str) -> RunFailed:
        return RunFailed(f"vehicle {self._name!r}: {what}")


def _put_back(part: NDArray, before: NDArray, rows: NDArray[np.intp]) -> NDArray:
    part = part.copy()
    part[rows] = before[rows]
    return part
