"""What is kept of the runs of a batch: cumulative figures tick by tick, everything else second by second."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.paper.flights import Flights
from kernels import interaction
from swarm import model, state
from swarm.scenario import Scenario
from worldsim.flight import LOST, Flight
from worldsim.summary import weight_spread, weight_spreads

Floats = NDArray[np.float64]
Scalar = float | int | bool | None

TRACE_EVERY_S = 0.2
PHI_S = 175.0  # the instant of the claims about fig. 3
CUMULATIVE = ("phi_A", "phi_C", "phi_C_distinct", "bits", "collisions")

SERIES = (
    "t_s",
    "speed_mean_m_s",
    "speed_min_m_s",
    "speed_max_m_s",
    "energy_mean_J",
    "energy_std_J",
    "energy_trip_mean_J",
    "energy_trip_std_J",
    "phi_A",
    "phi_C",
    "phi_C_distinct",
    "speed_difference_m_s",
    "near_pairs",
    "collisions",
    "arrived",
    "lost",
    "bits",
    "hjb_abs_mean",
    "hjb_abs_max",
    "fpk_abs_mean",
    "fpk_abs_max",
    "phi_G",
    "phi_G_learned",
    "distance_mean_m",
    "to_go_mean_m",
    "pair_distance_m",
    "weight_spread",
    "leader_value_norm",
    "leader_value_step",
    "value_norm_max",
    "density_norm_max",
    "state_norm_max",
)


@dataclass(frozen=True)
class Trace:
    """One run in full. t_s (T,), states (T, N, 4), status (T, N); weight_t_s (S,), weights (S, 246) of UAV 0."""

    t_s: Floats
    states: NDArray[np.float32]
    status: NDArray[np.uint8]
    weight_t_s: Floats
    weights: NDArray[np.float32]


@dataclass(frozen=True)
class Record:
    """series: `SERIES`, `(S,)` each, NaN where unknown. scalars: see `store`, None where unknown."""

    series: dict[str, Floats]
    scalars: dict[str, Scalar]
    trace: Trace | None


class Curves:
    """The record of all runs of a batch while they fly. A run keeps the number it took off with."""

    def __init__(self, flown: Scenario, seeds: Sequence[int], trace: Sequence[int]) -> None:
        self.runs = len(seeds)
        self._scenario = flown
        self._every = max(1, round(1.0 / flown.dt))
        self._trace_every = max(1, round(TRACE_EVERY_S / flown.dt))
        ticks = flown.max_ticks + 1
        self._speed_difference = np.zeros((self.runs, ticks))  # cumulative sums, one column a tick
        self._near = np.zeros((self.runs, ticks))
        self._bits = np.zeros((self.runs, ticks))
        self._collisions = np.zeros((self.runs, ticks))
        self._samples = np.full((self.runs, ticks // self._every + 1, len(SERIES)), np.nan)
        self._last_value: Floats = np.full((self.runs, 1), np.nan)
        self._path: dict[int, list[tuple[float, Floats, NDArray[np.uint8]]]] = {
            number: [] for number, seed in enumerate(seeds) if seed in trace
        }
        self._weights: dict[int, list[tuple[float, NDArray[np.float32]]]] = {number: [] for number in self._path}

    def samples(self, tick: int) -> bool:
        """Whether this tick is a whole second."""
        return tick % self._every == 0

    def tick(self, numbers: Sequence[int], flights: Flights, bits: Sequence[int]) -> None:
        """The cumulative figures of the runs still flying; `bits`: payload of each so far."""
        now = flights.tick
        self._speed_difference[numbers, now] = flights.speed_difference_sum
        self._near[numbers, now] = flights.near_sum
        self._bits[numbers, now] = bits
        self._collisions[numbers, now] = flights.collisions
        if self._path and now % self._trace_every == 0:
            for row, number in enumerate(numbers):
                if number in self._path:
                    here = flights.states[row].astype(np.float32), flights.status[row].copy()
                    self._path[number].append((now * self._scenario.dt, *here))

    def sample(
        self,
        numbers: Sequence[int],
        flights: Flights,
        bits: Sequence[int],
        diagnostics: Floats,
        weights: Floats,
    ) -> None:
        """One row of the series. diagnostics (R, N, 3): e_H, e_F, φ_G of the tick that led here."""
        (runs, n), cost = flights.status.shape, self._scenario.cost
        now = flights.tick
        states, way = flights.states, flights.arrival_tick >= 0
        speed = state.speed(states)
        trip = np.where(way, flights.arrival_energy, flights.energy)
        position = states[..., state.POSITION]
        models = weights.reshape(runs, n, -1)
        value = models[..., model.VALUE]
        leader = value[:, self._scenario.federation.leader]
        value_norm = np.sqrt((value * value).sum(axis=-1))
        density = models[..., model.DENSITY]
        size = np.abs(diagnostics[..., :2])
        known = now > 0
        learns_value, learns_density = self._scenario.method.learns_value, self._scenario.method.learns_density
        phi_a, phi_c, distinct = self._phi(numbers, now)
        if self._last_value.shape[1] == 1:
            self._last_value = np.full((self.runs, leader.shape[-1]), np.nan)
        step = np.sqrt(((leader - self._last_value[numbers]) ** 2).sum(axis=-1))
        self._last_value[numbers] = leader

        columns: dict[str, Any] = {
            "t_s": now * self._scenario.dt,
            "speed_mean_m_s": speed.mean(axis=1),
            "speed_min_m_s": speed.min(axis=1),
            "speed_max_m_s": speed.max(axis=1),
            "energy_mean_J": flights.energy.mean(axis=1),
            "energy_std_J": flights.energy.std(axis=1),
            "energy_trip_mean_J": trip.mean(axis=1),
            "energy_trip_std_J": trip.std(axis=1),
            "phi_A": phi_a,
            "phi_C": phi_c,
            "phi_C_distinct": distinct,
            "speed_difference_m_s": self._now(self._speed_difference, numbers, now),
            "near_pairs": self._now(self._near, numbers, now),
            "collisions": flights.collisions,
            "arrived": way.sum(axis=1),
            "lost": (flights.status == LOST).sum(axis=1),
            "bits": bits,
            "hjb_abs_mean": size[..., 0].mean(axis=1) if known and learns_value else np.nan,
            "hjb_abs_max": size[..., 0].max(axis=1) if known and learns_value else np.nan,
            "fpk_abs_mean": size[..., 1].mean(axis=1) if known and learns_density else np.nan,
            "fpk_abs_max": size[..., 1].max(axis=1) if known and learns_density else np.nan,
            "phi_G": interaction.empirical(states, states[:, None], cost.epsilon, cost.beta).mean(axis=1),
            "phi_G_learned": diagnostics[..., 2].mean(axis=1) if known and learns_value else np.nan,
            "distance_mean_m": flights.distance.mean(axis=1),
            "to_go_mean_m": np.sqrt((position * position).sum(axis=-1)).mean(axis=1),
            "pair_distance_m": _distances(states).sum(axis=(1, 2)) / (n * (n - 1)) if n > 1 else np.nan,
            "weight_spread": spreads(models, flights.status != LOST),
            "leader_value_norm": np.sqrt((leader * leader).sum(axis=-1)),
            "leader_value_step": step,
            "value_norm_max": value_norm.max(axis=1),
            "density_norm_max": np.sqrt((density * density).sum(axis=-1)).max(axis=1) if learns_density else np.nan,
            "state_norm_max": state.norm(states).max(axis=1),
        }
        assert tuple(columns) == SERIES
        for k, column in enumerate(columns.values()):
            self._samples[numbers, now // self._every, k] = column
        for row, number in enumerate(numbers):
            if number in self._weights:
                mine = models[row, self._scenario.federation.leader].astype(np.float32)
                self._weights[number].append((now * self._scenario.dt, mine))

    def of(self, number: int, flight: Flight) -> Record:
        """What is left of a run that ended."""
        samples = self._samples[number, : flight.tick // self._every + 1]
        series = {name: samples[:, k].copy() for k, name in enumerate(SERIES)}
        scalars = self._scalars(number, flight) | _windows(series) | _extremes(series)
        trace = None
        if number in self._path:
            path, weights = self._path[number], self._weights[number]
            trace = Trace(
                np.array([t for t, _, _ in path]),
                np.stack([states for _, states, _ in path]),
                np.stack([status for _, _, status in path]),
                np.array([t for t, _ in weights]),
                np.stack([vector for _, vector in weights]),
            )
        return Record(series, scalars, trace)

    def _phi(self, numbers: Any, tick: int) -> tuple[Any, Any, Any]:
        """φ_A, φ_C, φ_C of distinct pairs over ticks 0…tick, by the formulas of `Flight`."""
        n = self._scenario.uavs
        near = self._near[numbers, tick]
        phi_a = self._speed_difference[numbers, tick] / (tick + 1)
        phi_c = (2.0 * near / (tick + 1) + n) / n**2
        return phi_a, phi_c, 2.0 * near / (tick + 1) / (n * (n - 1)) if n > 1 else np.nan

    def _now(self, sums: Floats, numbers: Sequence[int], tick: int) -> Floats:
        return sums[numbers, tick] - (sums[numbers, tick - 1] if tick else 0.0)

    def _scalars(self, number: int, flight: Flight) -> dict[str, Scalar]:
        dt, end = self._scenario.dt, flight.tick
        arrived = flight.arrival_tick >= 0
        instants: dict[str, int | None] = {
            "175": round(PHI_S / dt) if round(PHI_S / dt) <= end else None,
            "tavg": round(float(flight.arrival_tick[arrived].mean())) if arrived.any() else None,
            "mission": int(flight.arrival_tick.max()) if arrived.all() else end,
        }
        result: dict[str, Scalar] = {
            "diverged": bool((flight.status == LOST).any()),
            "all_arrived": bool(arrived.all()),
            "t_avg_censored_s": float(np.where(arrived, flight.arrival_tick, self._scenario.max_ticks).mean()) * dt,
        }
        for name, tick in instants.items():
            figures: tuple[Any, ...] = (None,) * len(CUMULATIVE)
            if tick is not None:
                figures = (*self._phi(number, tick), self._bits[number, tick], self._collisions[number, tick])
            for column, figure in zip(CUMULATIVE, figures, strict=True):
                result[f"{column}_{name}"] = None if figure is None or np.isnan(figure) else float(figure)
        return result


def spreads(models: Floats, counted: NDArray[np.bool_]) -> Floats:
    """`weight_spread` of the counted UAVs of each run, `(R,)`; NaN where there is none.

    Args:
        models: (R, N, 246). counted: (R, N).
    """
    if counted.all():
        return weight_spreads(models)
    of_run = zip(models, counted, strict=True)
    return np.array([weight_spread(one[there]) if there.any() else np.nan for one, there in of_run])


def _distances(states: state.States) -> Floats:
    """Between all UAVs of each run, `(R, N, N)`, m."""
    along, across = (column[:, :, None] - column[:, None, :] for column in (states[..., state.X], states[..., state.Y]))
    along *= along
    across *= across
    along += across
    return np.sqrt(along, out=along)


def _windows(series: dict[str, Floats]) -> dict[str, Scalar]:
    """Means of a column over a span of seconds; None if the run was shorter or the column is unknown."""
    wanted = {
        "phi_G_125": ("phi_G", 0, 125),
        "phi_G_learned_125": ("phi_G_learned", 0, 125),
        "pair_distance_125": ("pair_distance_m", 0, 125),
        "hjb_abs_early": ("hjb_abs_mean", 0, 25),
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
    """Largest value of a column; None where it is unknown."""
    names = {"value_norm_max", "density_norm_max", "state_norm_max"}
    columns = {name: name for name in sorted(names)} | {"speed_max_all_m_s": "speed_max_m_s"}
    finite = {name: series[column][np.isfinite(series[column])] for name, column in columns.items()}
    return {name: float(values.max()) if len(values) else None for name, values in finite.items()}
