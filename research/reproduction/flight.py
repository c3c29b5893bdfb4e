"""One flight of the grid and its record: cumulative numbers of every tick, all others of every second."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.plan import plan_of
from meanflock.kernels.mean_field import interaction, layout
from meanflock.launch.engine import Engine
from meanflock.studies import job_file
from meanflock.studies.job_file import StoredRun, StoredTrace
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.counters import weight_spread
from meanflock.worldsim.flight import LOST, Flight
from research.reproduction.grid import Method

# -- record ------------------------------------------------------------------------------------------------------------


Floats = NDArray[np.float64]
Scalar = float | int | bool | None

PHI_S = 175.0  # the instant of the claims about fig. 3
_PAIRS_AT_ONCE = 2**16
CUMULATIVE = ("phi_A", "phi_C", "phi_C_distinct", "bits", "collisions")


@dataclass(frozen=True)
class FlightTrace:
    """One run in full. t_s (T,), states (T, N, 4), status (T, N); weight_t_s (S,), weights (S, 246) of UAV 0."""

    t_s: Floats
    states: NDArray[np.float32]
    status: NDArray[np.uint8]
    weight_t_s: Floats
    weights: NDArray[np.float32]


@dataclass(frozen=True)
class RunRecord:
    """series: as `series_of` makes it, `(S,)` each, NaN where unknown. scalars: see `store`, None where unknown."""

    series: dict[str, Floats]
    scalars: dict[str, Scalar]
    trace: FlightTrace | None


@dataclass(frozen=True)
class Sums:
    """Cumulative numbers at ticks 0…T, `(T + 1,)` each; see `Flight`. bits: payload."""

    speed_difference: Floats
    near: NDArray[np.int64]
    bits: NDArray[np.int64]
    collisions: NDArray[np.int64]

    def phi(self, tick: Any, n: int) -> tuple[Any, Any, Any]:
        """φ_A, φ_C, φ_C of distinct pairs of `n` UAVs over ticks 0…tick, by the formulas of `Flight`."""
        near = 2.0 * self.near[tick] / (tick + 1)
        distinct = near / (n * (n - 1)) if n > 1 else np.full(np.shape(tick), np.nan)
        return self.speed_difference[tick] / (tick + 1), (near + n) / n**2, distinct


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Snapshot of a flight at a whole second; with S seconds, every field has a leading axis (S,)."""

    tick: Any
    states: Floats  # (N, 4)
    status: NDArray[np.uint8]
    energy: Floats
    arrived: NDArray[np.bool_]
    arrival_energy: Floats
    distance: Floats
    diagnostics: Floats  # (N, 3): e_H, e_F, φ_G of the tick that led here
    leader_value: Floats  # ŵ_H of the leader UAV, (108,)
    weight_spread: Any
    value_spread: Any
    density_spread: Any
    value_norm_max: Any
    density_norm_max: Any


def series_of(scenario: Scenario, snapshot: Snapshot, sums: Sums) -> dict[str, Floats]:
    """The columns of series.parquet, `(S,)` each; `tables.py` documents them."""
    method = Method(scenario.method)
    tick = snapshot.tick
    states = snapshot.states
    speed, position = state.speed(states), state.position(states)
    trip = np.where(snapshot.arrived, snapshot.arrival_energy, snapshot.energy)
    phi_a, phi_c, distinct = sums.phi(tick, scenario.uavs)
    size, phi_learned = np.abs(snapshot.diagnostics[..., :2]), snapshot.diagnostics[..., 2].mean(axis=1)
    learning = method.learns_value & (tick > 0)  # before take-off nobody has learned anything
    size[~learning], phi_learned[~learning] = np.nan, np.nan
    if not method.learns_density:
        size[..., 1] = np.nan
    value = snapshot.leader_value
    columns: dict[str, Floats] = {
        "t_s": tick * scenario.dt,
        "speed_mean_m_s": speed.mean(axis=1),
        "speed_min_m_s": speed.min(axis=1),
        "speed_max_m_s": speed.max(axis=1),
        "energy_mean_J": snapshot.energy.mean(axis=1),
        "energy_std_J": snapshot.energy.std(axis=1),
        "energy_trip_mean_J": trip.mean(axis=1),
        "energy_trip_std_J": trip.std(axis=1),
        "phi_A": phi_a,
        "phi_C": phi_c,
        "phi_C_distinct": distinct,
        "speed_difference_m_s": np.diff(sums.speed_difference, prepend=0.0)[tick],
        "near_pairs": np.diff(sums.near, prepend=0)[tick],
        "collisions": sums.collisions[tick],
        "arrived": snapshot.arrived.sum(axis=1),
        "lost": (snapshot.status == LOST).sum(axis=1),
        "bits": sums.bits[tick],
        "hjb_abs_mean": size[..., 0].mean(axis=1),
        "hjb_abs_max": size[..., 0].max(axis=1),
        "hjb_abs_leader": size[:, scenario.federation.leader, 0],
        "fpk_abs_mean": size[..., 1].mean(axis=1),
        "fpk_abs_max": size[..., 1].max(axis=1),
        "phi_G": _in_parts(lambda part: _interaction(part, scenario), states),
        "phi_G_learned": phi_learned,
        "distance_mean_m": snapshot.distance.mean(axis=1),
        "to_go_mean_m": np.sqrt((position * position).sum(axis=-1)).mean(axis=1),
        "pair_distance_m": _in_parts(_pair_distance, states),
        "weight_spread": snapshot.weight_spread,
        "value_spread": snapshot.value_spread,
        "density_spread": snapshot.density_spread,
        "leader_value_norm": np.sqrt((value * value).sum(axis=-1)),
        "leader_value_step": np.sqrt((np.diff(value, axis=0, prepend=np.nan) ** 2).sum(axis=-1)),
        "value_norm_max": snapshot.value_norm_max,
        "density_norm_max": snapshot.density_norm_max,
        "state_norm_max": state.norm(states).max(axis=1),
    }
    return {name: column.astype(np.float64) for name, column in columns.items()}


def scalars_of(flight: Flight, series: dict[str, Floats], sums: Sums) -> dict[str, Scalar]:
    """Scalars of a finished flight that its summary does not have."""
    scenario, end = flight.scenario, flight.tick
    dt, arrived = scenario.dt, flight.arrival_tick >= 0
    instants: dict[str, int | None] = {
        "175": round(PHI_S / dt) if round(PHI_S / dt) <= end else None,
        "tavg": round(float(flight.arrival_tick[arrived].mean())) if arrived.any() else None,
        "mission": int(flight.arrival_tick.max()) if arrived.all() else end,
    }
    result: dict[str, Scalar] = {
        "diverged": bool((flight.status == LOST).any()),
        "all_arrived": bool(arrived.all()),
        "t_avg_censored_s": float(np.where(arrived, flight.arrival_tick, scenario.max_ticks).mean()) * dt,
    }
    for name, tick in instants.items():
        figures: tuple[Any, ...] = (None,) * len(CUMULATIVE)
        if tick is not None:
            figures = (*sums.phi(tick, scenario.uavs), sums.bits[tick], sums.collisions[tick])
        for column, figure in zip(CUMULATIVE, figures, strict=True):
            result[f"{column}_{name}"] = None if figure is None or np.isnan(figure) else float(figure)
        share = result[f"phi_C_distinct_{name}"]
        result[f"neighbours_{name}"] = None if share is None else share * (scenario.uavs - 1)
    for name in ("value_spread", "density_spread"):
        result[f"{name}_final"] = float(series[name][-1]) if np.isfinite(series[name][-1]) else None
    return result | _windows(series) | _extremes(series)


def _in_parts(function: Callable[[Floats], Floats], states: Floats) -> Floats:
    """Values of a function of pairs for `states` (S, N, 4), computed in parts that fit the cache."""
    at_once = max(1, _PAIRS_AT_ONCE // states.shape[1] ** 2)
    return np.concatenate([function(states[k : k + at_once]) for k in range(0, len(states), at_once)])


def _interaction(states: Floats, scenario: Scenario) -> Floats:
    """Mean φ_G among the true states of all, `(S,)`."""
    mean: Floats = interaction.empirical(states, states[:, None], scenario.cost.epsilon, scenario.cost.beta).mean(
        axis=1
    )
    return mean


def _pair_distance(states: Floats) -> Floats:
    """Mean distance of distinct pairs, `(S,)`, m; NaN for a swarm of one."""
    n = states.shape[1]
    if n == 1:
        return np.full(len(states), np.nan)
    along, across = (column[:, :, None] - column[:, None, :] for column in state.parts(state.position(states)))
    along *= along
    across *= across
    along += across
    total: Floats = np.sqrt(along, out=along).sum(axis=(1, 2)) / (n * (n - 1))
    return total


def _windows(series: dict[str, Floats]) -> dict[str, Scalar]:
    """Means of columns over a span of seconds; None if the run was shorter or the column has no values."""
    wanted = {
        "phi_G_125": ("phi_G", 0, 125),
        "phi_G_learned_125": ("phi_G_learned", 0, 125),
        "pair_distance_125": ("pair_distance_m", 0, 125),
        "hjb_abs_early": ("hjb_abs_mean", 0, 25),
        "hjb_abs_middle": ("hjb_abs_mean", 25, 100),
        "fpk_abs_middle": ("fpk_abs_mean", 25, 100),
        "hjb_abs_late": ("hjb_abs_mean", 150, 175),
        "fpk_abs_early": ("fpk_abs_mean", 0, 25),
        "fpk_abs_late": ("fpk_abs_mean", 150, 175),
        "leader_value_step_late": ("leader_value_step", 125, 175),
    }
    result: dict[str, Scalar] = {}
    for name, (column, first, last) in wanted.items():
        values = series[column][(series["t_s"] >= first) & (series["t_s"] <= last)]
        values = values[np.isfinite(values)]
        whole = len(series["t_s"]) and series["t_s"][-1] >= last
        result[name] = float(values.mean()) if whole and len(values) else None
    return result


def _extremes(series: dict[str, Floats]) -> dict[str, Scalar]:
    """Largest values of columns; None without values."""
    names = {"value_norm_max", "density_norm_max", "state_norm_max"}
    columns = {name: name for name in sorted(names)} | {
        "speed_max_all_m_s": "speed_max_m_s",
        "hjb_abs_mean_max": "hjb_abs_mean",
        "hjb_abs_leader_max": "hjb_abs_leader",
        "fpk_abs_mean_max": "fpk_abs_mean",
    }
    finite = {name: series[column][np.isfinite(series[column])] for name, column in columns.items()}
    return {name: float(values.max()) if len(values) else None for name, values in finite.items()}


def stored(key: str, scalars: dict[str, Any], record: RunRecord, with_series: bool) -> StoredRun:
    """The stored form of a run."""
    if not with_series:
        return StoredRun(key, scalars)
    block = np.stack(list(record.series.values()), axis=-1).astype("<f4")
    return StoredRun(key, scalars, tuple(record.series), block.tobytes(), _pack(record.trace))


def _pack(trace: FlightTrace | None) -> StoredTrace | None:
    if trace is None:
        return None
    return StoredTrace(
        (trace.states.shape[0], trace.states.shape[1]),
        trace.t_s.astype("<f8").tobytes(),
        trace.states.astype("<f4").tobytes(),
        trace.status.tobytes(),
        trace.weight_t_s.astype("<f8").tobytes(),
        trace.weights.astype("<f4").tobytes(),
    )


# -- recorder ----------------------------------------------------------------------------------------------------------


TRACE_EVERY_S = 0.2
LEARNING = ("hjb_residual", "fpk_residual", "phi_G")


class RunObserver:
    """Observer of a flight, for `Engine.complete`."""

    def __init__(self, scenario: Scenario, *, traced: bool = False) -> None:
        """`traced`: record the trajectory and the leader's weights too."""
        self._scenario = scenario
        self._every = max(1, round(1.0 / scenario.dt))
        self._trace_every = max(1, round(TRACE_EVERY_S / scenario.dt)) if traced else 0
        self._sums: list[tuple[float, int, int, int]] = []  # a tick each, in the order of `Sums`
        self._snapshots: list[Snapshot] = []  # one a second
        self._path: list[tuple[float, Floats, NDArray[np.uint8]]] = []
        self._weights: list[Floats] = []

    def __call__(self, engine: Engine) -> None:
        """Record the take-off or the end of a tick."""
        flight = engine.world.flight
        bits = int(engine.world.air.meter.total("payload_bits"))
        self._sums.append((flight.speed_difference_sum, flight.near_sum, bits, flight.collisions))
        if flight.tick % self._every == 0:
            models = engine.models
            self._snapshots.append(_look(flight, engine.world.commands.diagnostics, models))
            if self._trace_every:
                self._weights.append(models[self._scenario.federation.leader].astype(np.float32))
        if self._trace_every and flight.tick % self._trace_every == 0:
            self._path.append((flight.time_s, flight.states.astype(np.float32), flight.status.copy()))

    def record(self, flight: Flight) -> RunRecord:
        """The whole record of a finished flight."""
        sums = Sums(*(np.array(column) for column in zip(*self._sums, strict=True)))
        snapshots = Snapshot(
            *(np.stack([getattr(one, field.name) for one in self._snapshots]) for field in fields(Snapshot))
        )
        series = series_of(self._scenario, snapshots, sums)
        trace = None
        if self._trace_every:
            times, states, status = zip(*self._path, strict=True)
            trace = FlightTrace(
                np.array(times), np.stack(states), np.stack(status), series["t_s"], np.stack(self._weights)
            )
        return RunRecord(series, scalars_of(flight, series, sums), trace)


def _look(flight: Flight, diagnostics: Floats, models: Floats) -> Snapshot:
    """diagnostics: (N, K). models: (N, 246), as they are now."""
    scenario, alive = flight.scenario, flight.status != LOST
    if not models.shape[1]:  # offline learns nothing
        models = np.zeros((len(models), layout.MODEL_FLOATS))
    value, density = models[:, layout.VALUE], models[:, layout.DENSITY]
    learns_density = Method(scenario.method).learns_density
    return Snapshot(
        tick=flight.tick,
        states=flight.states,
        status=flight.status.copy(),
        energy=flight.energy.copy(),
        arrived=flight.arrival_tick >= 0,
        arrival_energy=flight.arrival_energy.copy(),
        distance=flight.distance.copy(),
        diagnostics=_by_name(plan_of(scenario).declared.diagnostics, diagnostics),
        leader_value=value[scenario.federation.leader].copy(),
        weight_spread=weight_spread(models[alive]) if alive.any() else np.nan,
        value_spread=weight_spread(value[alive]) if alive.any() else np.nan,
        density_spread=weight_spread(density[alive]) if alive.any() and learns_density else np.nan,
        value_norm_max=_largest_norm(value),
        density_norm_max=_largest_norm(density) if learns_density else np.nan,
    )


def _by_name(names: Sequence[str], diagnostics: Floats) -> Floats:
    """[e_H, e_F, φ_G] of every UAV, (N, 3); zeros for diagnostics that the method does not report."""
    columns = np.zeros((len(diagnostics), len(LEARNING)))
    for column, name in enumerate(LEARNING):
        if name in names:
            columns[:, column] = diagnostics[:, names.index(name)]
    return columns


def _largest_norm(weights: Floats) -> float:
    return float(np.sqrt((weights * weights).sum(axis=-1)).max())


# -- flight ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FlownRun:
    """summary: as in summary.json. record: curves and trace. models: the final weights, (N, 246)."""

    scenario: Scenario
    summary: dict[str, Any]
    record: RunRecord
    models: NDArray[np.float64]


def fly(scenario: Scenario, *, models: NDArray[np.float64] | None = None, traced: bool = False) -> FlownRun:
    """Fly a scenario in this process, without files and network.

    Args:
        models: (N, 246), what the UAVs take off with instead of knowing nothing. traced: whether trajectory and weights
            are kept.
    """
    engine = Engine(
        scenario, f"{scenario.method}-s{scenario.seed}", memory=None if models is None else {"weights": models}
    )
    recorder = RunObserver(scenario, traced=traced)
    summary = engine.complete(recorder)
    return FlownRun(scenario, summary, recorder.record(engine.world.flight), engine.models)


def version() -> str:
    """Version of the code that decides a run: the package's, and this file's."""
    return job_file.version(Path(__file__))
