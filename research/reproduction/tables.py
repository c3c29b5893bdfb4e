"""The tables of the paper's experiments: their columns, their construction from runs, and their reading.

Unknown is null, never 0. A run that serves several experiments (S0 is also N = 25 of `uavs`) has a row under each.
All flights of the grid go on to `duration` (300 s) whatever arrives, so every curve has the same length.

Coordinates, in every table
    experiment    s0 | uavs | period | period-tied | wind | offline | trained | sensitivity | random
                  | map | found | exchanged | exchanged-map | common | held-back | drift | density | losses
    method        hjb | mfg | mfgfl-h | mfgfl-f | mfgfl-hf | offline
    uavs          N
    period        n0, ticks; null where the method has no rounds
    sigma         σ_wind, m/s/√s
    setting       "" or what else differs from S0, as `--set` would write it, joined by ", ": "learner.kappa=0.1"
    seed          of the scenario; the same seed is the same wind under every method, so runs pair by it
    trained       whether the UAVs took off with the weights of an earlier flight (σ = 0.1), fig. 8c

runs.parquet adds (scalars of the summary, same names and meaning as in summary.json)
    key           scenario sha256 (+ "<" and that of the training flight): with `version`, the identity of a run
    version       package version and fingerprint of the code that decides a run
    ticks, sim_time_s, arrived, lost, t_avg_s (of those that arrived), t_max_s, energy_mean_J, energy_std_J (until own
    arrival; over UAVs), energy_end_mean_J, energy_end_std_J, phi_A, phi_C, phi_C_distinct (over the whole flight),
    collisions (pairs, both on the way), collisions_at_ticks (those of them that were so near at the end of a tick),
    speed_max_m_s, speed_mean_m_s (on the way), distance_mean_m, rounds, hjb_residual_max, fpk_residual_max (max |e|),
    weight_spread_final, trajectory_sha256
    bits_uplink, bits_broadcast, bits_state, bits_total     payload bits until the end of the flight
    sent, delivered, outages, outage_rate, outage_rate_theory, latency_slots_mean, latency_slots_mean_theory, airtime_s
    uplink_sent, uplink_outage_rate, uplink_outage_rate_theory, broadcast_outage_rate, state_outage_rate
  and what the summary does not say
    diverged      whether any UAV's learner or state left every bound (such runs stay in the table)
    all_arrived   arrived == uavs
    t_avg_censored_s   mean over all UAVs, one that never arrived counted with `duration`: a lower bound of T_avg
    {phi_A, phi_C, phi_C_distinct, bits, collisions}_{175, tavg, mission}    the cumulative figure at t = 175 s, at
                  T_avg (rounded to its tick; null if nobody arrived), at the end of the mission (last arrival, or
                  `duration` if one never arrived: what a flight with stop = "arrival" reports)
    neighbours_{175, tavg, mission} φ_C of distinct pairs times N − 1: how many a UAV has within r_C, on average
    hjb_abs_mean_max, hjb_abs_leader_max, fpk_abs_mean_max   largest, over whole seconds, of the mean over UAVs of
                  |e_H|, of |e_H| of the leader UAV, of the mean of |e_F|
    value_spread_final, density_spread_final   weight_spread of either half of the model, at the end
    phi_G_125, phi_G_learned_125    mean over 0…125 s of phi_G, phi_G_learned below (per second)
    pair_distance_125               mean over 0…125 s of the mean distance of distinct pairs, m
    {hjb_abs, fpk_abs}_{early, middle, late}   mean |e| over all UAVs and 0…25 s, 25…100 s, 150…175 s (per second)
    leader_value_step_late          mean over 125…175 s of leader_value_step below
    value_norm_max, density_norm_max, state_norm_max   largest ‖·‖ of any UAV at any whole second
    speed_max_all_m_s               largest speed of any UAV at any whole second, arrived ones included

series.parquet adds, at whole seconds t_s = 0, 1 … duration, over all UAVs whether they arrived or not
    t_s
    speed_mean_m_s, speed_min_m_s, speed_max_m_s
    energy_mean_J, energy_std_J                 since take-off
    energy_trip_mean_J, energy_trip_std_J       since take-off, fixed at own arrival
    phi_A, phi_C, phi_C_distinct                cumulative means, as printed
    speed_difference_m_s                        mean over all N² pairs now: what phi_A averages
    near_pairs                                  distinct pairs within r_C now
    collisions, arrived, lost                   so far
    bits                                        payload so far
    hjb_abs_mean, hjb_abs_max, hjb_abs_leader, fpk_abs_mean, fpk_abs_max   |e_H|, |e_F| of the tick that led here (row
                  0: null)
    phi_G           mean over UAVs of the empirical φ_G of the true states
    phi_G_learned   mean over UAVs of the φ_G they act on (m̂'s, or of the received states for hjb; row 0: null)
    distance_mean_m                             flown, until own arrival
    to_go_mean_m                                mean ‖r‖
    pair_distance_m                             mean distance of distinct pairs; null for N = 1
    weight_spread, value_spread, density_spread   root-mean-square distance of the N models, or of their parts, from
                  the mean
    leader_value_norm, leader_value_step        ‖ŵ_H‖ of the leader UAV; its change ‖ŵ_H(t) − ŵ_H(t − 1 s)‖
    value_norm_max, density_norm_max, state_norm_max    largest of any UAV

trajectories.parquet adds: t_s (every 0.2 s), uav, x_m, y_m, vx_m_s, vy_m_s, status (0 flying, 1 arrived, 2 lost)
weights.parquet adds: t_s, model (246 floats of UAV 0: [ŵ_H0 (54), ŵ_H1 (54), ŵ_F0 (69), ŵ_F1 (69)]; none for `offline`)
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from meanflock.studies.job_file import StoredRun, StoredTrace
from meanflock.studies.store import DATA
from meanflock.swarm.errors import BadInput
from research.reproduction.flight import version

COORDINATES = pa.schema(
    [
        ("experiment", pa.string()),
        ("method", pa.string()),
        ("uavs", pa.int32()),
        ("period", pa.int32()),
        ("sigma", pa.float64()),
        ("setting", pa.string()),
        ("seed", pa.int64()),
        ("trained", pa.bool_()),
    ]
)


@dataclass(frozen=True)
class Results:
    """The tables described at the top of this module."""

    runs: pa.Table
    series: pa.Table
    trajectories: pa.Table
    weights: pa.Table

    @property
    def diverged(self) -> int:
        """Number of rows of `runs` in which a learner or a state diverged."""
        return int(np.count_nonzero(self.runs["diverged"].to_numpy(zero_copy_only=False)))


def tables(rows: Iterable[tuple[Mapping[str, Any], StoredRun, bool, bool]]) -> Results:
    """Makes the tables of (coordinates, run, whether its series is shown, whether its trace is)."""
    runs: list[dict[str, Any]] = []
    parts: dict[str, list[pa.Table]] = {"series": [], "trajectories": [], "weights": []}
    for coordinates, run, with_series, with_trace in rows:
        runs.append({**coordinates, "key": run.key, "version": version(), **run.scalars})
        if with_series and run.series is not None:
            columns = {name: pa.array(values, from_pandas=True) for name, values in run.table().items()}
            parts["series"].append(_under(coordinates, columns))
        if with_trace and run.trace is not None:
            for name, columns in _unpack(run.trace):
                parts[name].append(_under(coordinates, columns))
    joined = {
        name: pa.concat_tables(tables).combine_chunks() if tables else COORDINATES.empty_table()
        for name, tables in parts.items()
    }
    return Results(runs=_typed(runs), **joined)


def _typed(rows: list[dict[str, Any]]) -> pa.Table:
    """A table of these rows; a column without values has null floats."""
    if not rows:
        return COORDINATES.empty_table()
    return pa.Table.from_pylist(rows, schema=pa.schema([(name, _type(name, rows)) for name in rows[0]]))


def _type(name: str, rows: list[dict[str, Any]]) -> pa.DataType:
    if name in COORDINATES.names:
        return COORDINATES.field(name).type
    kinds = {type(row[name]) for row in rows} - {type(None)}
    if kinds == {int}:
        return pa.int64()
    if kinds == {bool}:
        return pa.bool_()
    return pa.string() if kinds == {str} else pa.float64()


def _under(coordinates: Mapping[str, Any], columns: Mapping[str, pa.Array]) -> pa.Table:
    length = len(next(iter(columns.values())))
    fixed = {field.name: pa.repeat(pa.scalar(coordinates[field.name], field.type), length) for field in COORDINATES}
    return pa.table({**fixed, **columns})


def _unpack(trace: StoredTrace) -> Iterator[tuple[str, dict[str, pa.Array]]]:
    instants, uavs = trace.shape
    states = np.frombuffer(trace.states, "<f4").reshape(-1, 4)
    yield (
        "trajectories",
        {
            "t_s": pa.array(np.repeat(np.frombuffer(trace.t_s, "<f8"), uavs)),
            "uav": pa.array(np.tile(np.arange(uavs, dtype=np.int32), instants)),
            **{name: pa.array(states[:, k].copy()) for k, name in enumerate(("x_m", "y_m", "vx_m_s", "vy_m_s"))},
            "status": pa.array(np.frombuffer(trace.status, np.uint8)),
        },
    )
    times = np.frombuffer(trace.weight_t_s, "<f8")
    weights = np.frombuffer(trace.weights, "<f4")
    width = len(weights) // len(times)
    offsets = np.arange(len(times) + 1, dtype=np.int32) * np.int32(width)  # 0 wide: a method that learns nothing
    yield "weights", {"t_s": pa.array(times), "model": pa.ListArray.from_arrays(offsets, weights)}


def load(out: Path) -> Results:
    """Read the tables of the grid in `out`.

    Raises:
        BadInput: it left none.
    """
    tables = {}
    for name in ("runs", "series", "trajectories", "weights"):
        path = out / DATA / f"{name}.parquet"
        try:
            tables[name] = pq.read_table(path)
        except (OSError, pa.ArrowInvalid) as error:
            raise BadInput(f"{path}: {error}; fly the experiments first") from error
    return Results(**tables)


# -- reading the tables ------------------------------------------------------------------------------------------------


Floats = NDArray[np.float64]

COORDINATE = {
    "uavs": "uavs",
    "period": "period",
    "period-tied": "period",
    "wind": "sigma",
    "offline": "sigma",
    "trained": "sigma",
}  # experiment → the column its grid runs along


class Frame:
    """Rows of a table. Columns become arrays when they are asked for; null becomes NaN."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def __contains__(self, name: str) -> bool:
        return name in self._table.column_names

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column: float64 for numbers and truth values, objects for text, `(rows, n)` for lists."""
        column = self._table.column(name).combine_chunks()
        if pa.types.is_list(column.type):
            return np.array(column.to_pylist(), dtype=np.float64)
        if pa.types.is_string(column.type):
            return np.array(column.to_pylist(), dtype=object)
        return column.cast(pa.float64()).to_numpy(zero_copy_only=False)

    def where(self, **equal: Any) -> "Frame":
        """The rows whose columns equal the values given; numbers to one part in a billion."""
        table = self._table
        for name, value in equal.items():
            column = table.column(name)
            if isinstance(value, float):
                near = pc.less_equal(pc.abs(pc.subtract(column, value)), 1e-9 * max(1.0, abs(value)))
                table = table.filter(near)
            else:
                table = table.filter(pc.equal(column, value))
        return Frame(table)

    def distinct(self, name: str) -> list[Any]:
        """The values of a column, ascending, without null."""
        return sorted(value for value in pc.unique(self._table.column(name)).to_pylist() if value is not None)

    def by_seed(self, metric: str) -> dict[int, float]:
        """seed → value; empty where the metric is not recorded.

        Raises:
            ValueError: a seed has several rows.
        """
        if metric not in self or not len(self):
            return {}
        seeds = self["seed"].astype(int).tolist()
        if len(set(seeds)) < len(seeds):
            raise ValueError(f"{metric}: several runs a seed; select by setting or trained too")
        return dict(zip(seeds, self[metric].tolist(), strict=True))


def paired(*columns: Mapping[int, float]) -> list[Floats]:
    """The values of the seeds all columns have, in the order of the seeds."""
    seeds = sorted(set.intersection(*(set(column) for column in columns))) if columns else []
    return [np.array([column[seed] for seed in seeds]) for column in columns]


@dataclass(frozen=True)
class View:
    """The tables of a grid as frames, and what `measure.py` measured: name → a value a seed."""

    runs: Frame
    series: Frame
    trajectories: Frame
    weights: Frame
    measured: Mapping[str, Sequence[float]]

    @classmethod
    def from_results(cls, results: Results, measured: Mapping[str, Sequence[float]] | None = None) -> "View":
        """The frames of what `tables.load` or `run_grid` returned."""
        return cls(
            Frame(results.runs),
            Frame(results.series),
            Frame(results.trajectories),
            Frame(results.weights),
            measured or {},
        )

    def cell(self, experiment: str, method: str, point: float | None = None, **more: Any) -> Frame:
        """The runs of a method in an experiment, at one point of its grid or at all; `more` as in `where`."""
        frame = self.runs.where(experiment=experiment, method=method, **more)
        return frame if point is None else frame.where(**{COORDINATE[experiment]: float(point)})

    def values(
        self, experiment: str, method: str, metric: str, point: float | None = None, **more: Any
    ) -> dict[int, float]:
        """Values of a metric in these runs: seed → value."""
        return self.cell(experiment, method, point, **more).by_seed(metric)

    def points(self, experiment: str) -> list[float]:
        """The points of an experiment's grid, ascending."""
        return [float(point) for point in self.runs.where(experiment=experiment).distinct(COORDINATE[experiment])]
