"""The vehicles of all UAVs of a flight, which may be of several kinds."""

from typing import NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from meanflock.swarm import mission, state
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.plugins import load
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask
from meanflock.worldsim.vehicles.base import Hidden, Moved, Physics


class _Kind(NamedTuple):
    """The UAVs (M,) that have one kind of vehicle. columns: of what it shows, among those of all."""

    uavs: NDArray[np.intp]
    physics: Physics
    columns: list[int]


class FlownVehicles:
    """The vehicles of a scenario. The UAVs of one kind move in one call, and their hidden arrays have their rows only.

    Attributes:
        limit: (N,), the longest acceleration that a UAV can command, m/s², or infinite; a number: that of all UAVs;
            None: there is no limit.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Raises BadInput if a vehicle is not installed, does not fly in the dimensions of the scenario, or its options
        do not fit.
        """
        kinds: list[tuple[Scenario, NDArray[np.intp]]] = []
        for group, rows in mission.parts(scenario):
            table, uavs = group.vehicle or scenario.vehicle, np.arange(rows.start, rows.stop)
            has_file = group.vehicle is not None and group.vehicle.file is not None  # with the tracks of its UAVs alone
            same = [number for number, (flown, _) in enumerate(kinds) if flown.vehicle == table and not has_file]
            if same:
                kinds[same[0]] = kinds[same[0]][0], np.concatenate([kinds[same[0]][1], uavs])
            else:
                kinds.append((scenario.alone(group) if has_file else structs.replace(scenario, vehicle=table), uavs))
        kinds = kinds or [(scenario, np.arange(scenario.uavs))]
        shows = [tuple(getattr(load("vehicle", flown.vehicle.model), "columns", ())) for flown, _ in kinds]
        columns = list(dict.fromkeys(name for names in shows for name in names))
        self._shape = scenario.uavs, len(columns)
        self._kinds = [
            _Kind(uavs, Physics(flown, uavs), [columns.index(name) for name in names])
            for (flown, uavs), names in zip(kinds, shows, strict=True)
        ]
        limits = [flown.vehicle.acceleration_max for flown, _ in kinds]
        self.limit: Floats | float | None = limits[0]
        if len(kinds) > 1 and any(limit is not None for limit in limits):
            self.limit = np.full(scenario.uavs, np.inf)
            for limit, (_, uavs) in zip(limits, kinds, strict=True):
                self.limit[uavs] = np.inf if limit is None else limit

    def init(self) -> Hidden:
        """The hidden state of all UAVs at take-off; raises BadInput if `init` or `shown` of a vehicle fails."""
        parts = [kind.physics.init() for kind in self._kinds]
        hidden = parts[0] if len(parts) == 1 else self._joined(parts)
        if self._shape[1]:
            try:
                self.shown({name: part.copy() for name, part in hidden.items()})
            except RunFailed as error:
                raise BadInput(str(error)) from error
        return hidden

    def felt(self, accelerations: state.Vectors, gust: state.Vectors | None) -> state.Vectors:
        """Commands (N, d), with gusts (N, d) of UAVs whose vehicle does not take these apart, m/s²."""
        if gust is None:
            return accelerations
        if len(self._kinds) == 1:
            return accelerations if self._kinds[0].physics.takes_push else accelerations + gust
        felt = accelerations + gust
        for kind in self._kinds:
            if kind.physics.takes_push:
                felt[kind.uavs] = accelerations[kind.uavs]
        return felt

    def step(
        self,
        states: state.States,
        hidden: Hidden,
        acceleration: state.Vectors,
        noise: state.Vectors,
        waiting: Mask | None,
        gust: state.Vectors | None = None,
    ) -> Moved:
        """See `Physics.step`."""
        if len(self._kinds) == 1:
            return self._kinds[0].physics.step(states, hidden, acceleration, noise, waiting, gust)
        after, changed, diverged = np.empty_like(states), [], []
        for number, (uavs, physics, _) in enumerate(self._kinds):
            moved = physics.step(
                states[uavs],
                self._part(hidden, number),
                acceleration[uavs],
                noise[uavs],
                None if waiting is None else waiting[uavs],
                None if gust is None else gust[uavs],
            )
            after[uavs] = moved.states
            changed.append(moved.hidden)
            diverged.append(uavs[moved.diverged])
        return Moved(after, self._joined(changed), np.sort(np.concatenate(diverged)))

    def power(self, states: state.States, hidden: Hidden, acceleration: state.Vectors) -> state.Rows:
        """See `Physics.power`."""
        if len(self._kinds) == 1:
            return self._kinds[0].physics.power(states, hidden, acceleration)
        power = np.empty(len(states))
        ticks = np.arange(len(states) // self._shape[0])[:, None] * self._shape[0]
        for number, (uavs, physics, _) in enumerate(self._kinds):
            rows = (ticks + uavs).ravel()
            power[rows] = physics.power(states[rows], self._part(hidden, number), acceleration[rows])
        return power

    def shown(self, hidden: Hidden) -> Floats:
        """The numbers (N, C) that the vehicles show of all UAVs; 0 for those that the vehicle of a UAV has not.

        Raises:
            RunFailed: see `Physics.step`.
        """
        if len(self._kinds) == 1:
            return self._kinds[0].physics.shown(hidden, self._shape[1])
        shown = np.zeros(self._shape)
        for number, (uavs, physics, columns) in enumerate(self._kinds):
            if columns:
                shown[uavs[:, None], columns] = physics.shown(self._part(hidden, number), len(columns))
        return shown

    def _joined(self, parts: list[Hidden]) -> Hidden:
        """The hidden arrays of all kinds, named by number of the kind and name."""
        return {f"{number}.{name}": array for number, part in enumerate(parts) for name, array in part.items()}

    def _part(self, hidden: Hidden, number: int) -> Hidden:
        mark = f"{number}."
        return {name[len(mark) :]: array for name, array in hidden.items() if name.startswith(mark)}
