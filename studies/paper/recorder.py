"""Looks at a flight of the engine tick by tick, and makes the record that the grid keeps of it."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from meanflock.groundstation.launch.engine import Engine
from meanflock.kernels.mean_field import layout
from meanflock.studies.paper.methods import Method
from meanflock.studies.paper.series import Record, Seen, Sums, Trace, scalars_of, series_of
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.flight import LOST, Flight
from meanflock.worldsim.summary import weight_spread

Floats = NDArray[np.float64]

TRACE_EVERY_S = 0.2
LEARNING = ("hjb_residual", "fpk_residual", "phi_G")


class Recorder:
    """What `Engine.complete` shows a flight to."""

    def __init__(self, scenario: Scenario, *, traced: bool = False) -> None:
        """`traced`: whether trajectory and weights are kept."""
        self._scenario = scenario
        self._every = max(1, round(1.0 / scenario.dt))
        self._trace_every = max(1, round(TRACE_EVERY_S / scenario.dt)) if traced else 0
        self._sums: list[tuple[float, int, int, int]] = []  # a tick each, in the order of `Sums`
        self._seen: list[Seen] = []  # a second each
        self._path: list[tuple[float, Floats, NDArray[np.uint8]]] = []
        self._weights: list[Floats] = []

    def __call__(self, engine: Engine) -> None:
        """Take-off, or the end of a tick."""
        flight = engine.world.flight
        bits = int(engine.world.air.meter.total("payload_bits"))
        self._sums.append((flight.speed_difference_sum, flight.near_sum, bits, flight.collisions))
        if flight.tick % self._every == 0:
            models = engine.models
            self._seen.append(_look(flight, engine.world.diagnostics, models))
            if self._trace_every:
                self._weights.append(models[self._scenario.federation.leader].astype(np.float32))
        if self._trace_every and flight.tick % self._trace_every == 0:
            self._path.append((flight.time_s, flight.states.astype(np.float32), flight.status.copy()))

    def record(self, flight: Flight) -> Record:
        """All of it, once the flight is over."""
        sums = Sums(*(np.array(column) for column in zip(*self._sums, strict=True)))
        seen = Seen(*(np.stack([getattr(one, field.name) for one in self._seen]) for field in fields(Seen)))
        series = series_of(self._scenario, seen, sums)
        trace = None
        if self._trace_every:
            times, states, status = zip(*self._path, strict=True)
            trace = Trace(np.array(times), np.stack(states), np.stack(status), series["t_s"], np.stack(self._weights))
        return Record(series, scalars_of(flight, series, sums), trace)


def _look(flight: Flight, diagnostics: Floats, models: Floats) -> Seen:
    """diagnostics: (N, K). models: (N, 246), as they are now."""
    scenario, alive = flight.scenario, flight.status != LOST
    if not models.shape[1]:  # offline learns nothing
        models = np.zeros((len(models), layout.MODEL_FLOATS))
    value, density = models[:, layout.VALUE], models[:, layout.DENSITY]
    learns_density = Method(scenario.method).learns_density
    return Seen(
        tick=flight.tick,
        states=flight.states,
        status=flight.status.copy(),
        energy=flight.energy.copy(),
        arrived=flight.arrival_tick >= 0,
        arrival_energy=flight.arrival_energy.copy(),
        distance=flight.distance.copy(),
        diagnostics=_by_name(scenario.declared.diagnostics, diagnostics),
        leader_value=value[scenario.federation.leader].copy(),
        weight_spread=weight_spread(models[alive]) if alive.any() else np.nan,
        value_spread=weight_spread(value[alive]) if alive.any() else np.nan,
        density_spread=weight_spread(density[alive]) if alive.any() and learns_density else np.nan,
        value_norm_max=_largest_norm(value),
        density_norm_max=_largest_norm(density) if learns_density else np.nan,
    )


def _by_name(names: Sequence[str], diagnostics: Floats) -> Floats:
    """[e_H, e_F, φ_G] of every UAV, (N, 3); zeros of what the method does not report."""
    columns = np.zeros((len(diagnostics), len(LEARNING)))
    for column, name in enumerate(LEARNING):
        if name in names:
            columns[:, column] = diagnostics[:, names.index(name)]
    return columns


def _largest_norm(weights: Floats) -> float:
    return float(np.sqrt((weights * weights).sum(axis=-1)).max())
