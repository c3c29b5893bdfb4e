"""Motion and power by the vehicle of the scenario. The results of the vehicle are checked here, and only here."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import plugins, state
from meanflock.swarm.errors import FAILURES, BadInput, RunFailed, last_line
from meanflock.swarm.plugins.guard import check_array, check_memory, check_pair, check_same_form
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.base import Hidden, Vehicle

BOUND = 1e9  # m or m/s; a UAV beyond it counts as diverged


class Moved(NamedTuple):
    """Result of a tick. states: (N, 4). hidden: as of `init`. power: (N,), W. diverged: (K,), UAVs put back to rest."""

    states: state.States
    hidden: Hidden
    power: state.Rows
    diverged: NDArray[np.intp]


_NOBODY = np.zeros(0, dtype=np.intp)


class Physics:
    """The vehicle of a scenario."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises BadInput if the scenario's vehicle is not installed or its options do not fit."""
        chosen = scenario.vehicle
        self._name = chosen.model
        self._vehicle: Vehicle = plugins.create("vehicle", chosen.model, chosen.options, scenario.flown())

    def init(self, uavs: int) -> Hidden:
        """The hidden state of so many UAVs at take-off; raises BadInput if `init` of the vehicle fails."""
        try:
            hidden = self._asked("init", uavs)
            check_memory("`init`: hidden", hidden, uavs)
            for name, part in hidden.items():
                _check_finite(f"hidden[{name!r}] of `init`", part)
        except (RunFailed, TypeError, ValueError) as error:
            raise BadInput(f"vehicle {self._name!r}: {error}") from error
        return dict(hidden)

    def __call__(
        self,
        states: state.States,
        hidden: Hidden,
        acceleration: state.Plane,
        noise: state.Plane,
        waiting: NDArray[np.bool_] | None = None,
    ) -> Moved:
        """Move all UAVs for one tick, by `Vehicle.step`. UAVs that are `waiting`, (N,), stay at rest and spend nothing.

        Raises:
            RunFailed: the vehicle raised, or its result is invalid; the message names the vehicle and the UAV.
        """
        try:
            return self._moved(states, hidden, acceleration, noise, waiting)
        except (RunFailed, TypeError, ValueError) as error:
            raise RunFailed(f"vehicle {self._name!r}: {error}") from error

    def _moved(
        self,
        states: state.States,
        hidden: Hidden,
        acceleration: state.Plane,
        noise: state.Plane,
        waiting: NDArray[np.bool_] | None,
    ) -> Moved:
        for array in (states, *hidden.values()):
            array.flags.writeable = False
        answer = self._asked("step", states, dict(hidden), acceleration, noise)
        moved, changed = check_pair("step", answer, "states and hidden state")
        check_array("states", moved, states.shape, states.dtype)
        check_same_form("hidden", changed, hidden)
        for name, part in changed.items():
            _check_finite(f"hidden[{name!r}]", part)
        moved, diverged = np.ascontiguousarray(moved), _NOBODY
        if not np.maximum.reduce(np.abs(moved), axis=None) < BOUND:
            far = ~(np.abs(moved) < BOUND).all(axis=-1)  # NaN is below nothing
            finite = np.isfinite(acceleration).all(axis=-1)
            _check_finite("states", moved[far & finite], np.flatnonzero(far & finite))
            moved, diverged = moved.copy(), np.flatnonzero(far)
            moved[far] = states[far]
            moved[far, state.VELOCITY] = 0.0
            acceleration = np.where(far[:, None], 0.0, acceleration)
            changed = {name: _put_back(part, hidden[name], diverged) for name, part in changed.items()}
        power = self._asked("power", moved, changed, acceleration)
        check_array("power", power, (len(states),), states.dtype)
        _check_finite("power", power)
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
            raise RunFailed(f"`{method}` failed: {last_line(error)}") from error


def _check_finite(what: str, array: NDArray, uavs: NDArray[np.intp] | None = None) -> None:
    """Check that an array has finite numbers only; its rows are those of `uavs`, or of all UAVs."""
    if np.count_nonzero(finite := np.isfinite(array)) < array.size:
        row = int(np.flatnonzero(~finite.reshape(len(array), -1).all(axis=-1))[0])
        uav = row if uavs is None else uavs[row]
        raise ValueError(f"{what} of UAV {uav}: {array[row]} is not finite")


def _put_back(part: NDArray, before: NDArray, rows: NDArray[np.intp]) -> NDArray:
    part = part.copy()
    part[rows] = before[rows]
    return part
