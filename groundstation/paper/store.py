"""What the grid leaves on disk, and the tables made of it.

    DIR/data/jobs/*.job          one file a finished run: checked, atomic, the only thing a resumed grid trusts
    DIR/data/runs.parquet        one row per experiment and run
    DIR/data/series.parquet      one row per experiment, run and second (not for `sensitivity` and `random`)
    DIR/data/trajectories.parquet  one row per traced run, instant and UAV (first seed of `s0`, `offline`, `trained`)
    DIR/data/weights.parquet     one row per traced run and second: UAV 0's whole model

Unknown is null, never 0. A run that serves several experiments (S0 is also N = 25 of `uavs`) has a row under each.
All flights of the grid go on to `duration` (300 s) whatever arrives, so every curve has the same length.

Coordinates, in every table
    experiment    s0 | uavs | period | period-tied | wind | offline | trained | sensitivity | random
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
    collisions (pairs, both on the way), speed_max_m_s, speed_mean_m_s (on the way), distance_mean_m, rounds,
    hjb_residual_max, fpk_residual_max (max |e|), weight_spread_final, trajectory_sha256
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
    phi_G_125, phi_G_learned_125    mean over 0…125 s of phi_G, phi_G_learned below (per second)
    pair_distance_125               mean over 0…125 s of the mean distance of distinct pairs, m
    {hjb_abs, fpk_abs}_{early, late}   mean |e| over all UAVs and 0…25 s, 150…175 s (per second)
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
    hjb_abs_mean, hjb_abs_max, fpk_abs_mean, fpk_abs_max   |e_H|, |e_F| of the tick that led here (row 0: null)
    phi_G           mean over UAVs of the empirical φ_G of the true states
    phi_G_learned   mean over UAVs of the φ_G they act on (m̂'s, or of the received states for hjb; row 0: null)
    distance_mean_m                             flown, until own arrival
    to_go_mean_m                                mean ‖r‖
    pair_distance_m                             mean distance of distinct pairs; null for N = 1
    weight_spread                               root-mean-square distance of the N models from their mean
    leader_value_norm, leader_value_step        ‖ŵ_H‖ of the leader UAV; its change ‖ŵ_H(t) − ŵ_H(t − 1 s)‖
    value_norm_max, density_norm_max, state_norm_max    largest of any UAV

trajectories.parquet adds: t_s (every 0.2 s), uav, x_m, y_m, vx_m_s, vy_m_s, status (0 flying, 1 arrived, 2 lost)
weights.parquet adds: t_s, model (246 floats of UAV 0: [ŵ_H0 (54), ŵ_H1 (54), ŵ_F0 (69), ŵ_F1 (69)]; none for `offline`)
"""

import ast
import hashlib
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from meanflock import agent, channel, kernels, leader, swarm, worldsim
from meanflock.groundstation import durable
from meanflock.groundstation.paper.series import Record, Trace
from meanflock.swarm.errors import BadInput, RunFailed

DATA = "data"
_MAGIC = b"meanflock job 1\n"
_DIGEST = hashlib.sha256().digest_size
_ROOMS = (swarm, kernels, agent, channel, leader, worldsim)
_HERE = ("flown.py", "recorder.py", "series.py", "../engine.py")


class StoredTrace(msgspec.Struct, frozen=True):
    """`Trace` as bytes, little-endian."""

    shape: tuple[int, int]  # instants, UAVs
    t_s: bytes
    states: bytes
    status: bytes
    weight_t_s: bytes
    weights: bytes


class StoredRun(msgspec.Struct, frozen=True):
    """One finished run. series: (S, columns) little-endian f4, `columns` of them; None where none is kept."""

    key: str
    scalars: dict[str, Any]
    columns: tuple[str, ...] = ()
    series: bytes | None = None
    trace: StoredTrace | None = None

    def table(self) -> dict[str, np.ndarray]:
        """The series by column, NaN where unknown."""
        if self.series is None:
            return {}
        values = np.frombuffer(self.series, "<f4").reshape(-1, len(self.columns))
        return {name: values[:, k] for k, name in enumerate(self.columns)}


class _Body(msgspec.Struct, frozen=True):
    version: str
    runs: tuple[StoredRun, ...]


@cache
def version() -> str:
    """Package version and a fingerprint of the code that decides a run: results of other code are never trusted.

    The fingerprint is of the syntax trees without docstrings, so words may be mended without flying again.
    """
    digest = hashlib.sha256()
    for room in _ROOMS:
        folder = Path(str(room.__file__)).parent
        for path in sorted(folder.rglob("*.*")):
            if path.suffix == ".py":
                digest.update(path.relative_to(folder).as_posix().encode() + _syntax(path.read_text(encoding="utf-8")))
            elif path.suffix == ".csv":
                digest.update(path.read_bytes())
    for name in _HERE:
        digest.update(_syntax((Path(__file__).parent / name).read_text(encoding="utf-8")))
    return f"{swarm.__version__}+{digest.hexdigest()[:12]}"


def _syntax(source: str) -> bytes:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if (
            isinstance(body, list)
            and body
            and isinstance(body[0], ast.Expr)
            and isinstance(body[0].value, ast.Constant)
        ):
            body[0].value.value = None
    return ast.dump(tree).encode()


def stored(key: str, scalars: dict[str, Any], record: Record, with_series: bool) -> StoredRun:
    """A run as it is kept."""
    if not with_series:
        return StoredRun(key, scalars)
    block = np.stack(list(record.series.values()), axis=-1).astype("<f4")
    return StoredRun(key, scalars, tuple(record.series), block.tobytes(), _pack(record.trace))


def _pack(trace: Trace | None) -> StoredTrace | None:
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


def encode(runs: Iterable[StoredRun]) -> bytes:
    """A job file: a line to know it by, the hash of the rest, the rest."""
    body = zlib.compress(msgspec.msgpack.encode(_Body(version(), tuple(runs))), 1)
    return _MAGIC + hashlib.sha256(body).digest() + body


def decode(raw: bytes) -> tuple[StoredRun, ...]:
    """The runs of a job file of this version.

    Raises:
        ValueError: not whole, not a job file, or of another version.
    """
    if raw[: len(_MAGIC)] != _MAGIC:
        raise ValueError("not a job file")
    digest, body = raw[len(_MAGIC) : len(_MAGIC) + _DIGEST], raw[len(_MAGIC) + _DIGEST :]
    if hashlib.sha256(body).digest() != digest:
        raise ValueError("damaged")
    try:
        content = msgspec.msgpack.decode(zlib.decompress(body), type=_Body)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error
    if content.version != version():
        raise ValueError(f"of version {content.version}")
    return content.runs


class Store:
    """The job files of one output folder, and the tables made of them."""

    def __init__(self, out: Path) -> None:
        """Raises BadInput where the folder cannot be made."""
        self.data = out / DATA
        self._jobs = self.data / "jobs"
        try:
            self._jobs.mkdir(parents=True, exist_ok=True)
            for left_over in self._jobs.glob(".*.part"):
                left_over.unlink()
        except OSError as error:
            raise BadInput(f"--out {out}: {error.strerror}; name a folder that can be written") from error

    def finished(self) -> dict[str, StoredRun]:
        """Every run that is safely there, by key. What cannot be trusted is deleted: it will be flown again."""
        runs: dict[str, StoredRun] = {}
        for path in sorted(self._jobs.glob("*.job")):
            try:
                runs.update((run.key, run) for run in decode(path.read_bytes()))
            except ValueError:
                path.unlink(missing_ok=True)
        return runs

    def add(self, raw: bytes) -> None:
        """Keeps the encoded runs of a job.

        Raises:
            RunFailed: the disk is full or the folder gone, or the worker runs other code than this process; what was
                finished before is kept.
        """
        try:
            decode(raw)
        except ValueError as error:
            raise RunFailed(f"a worker's result is {error}, this is {version()}: give workers the same code") from error
        self.write(self._jobs / f"{hashlib.sha256(raw).hexdigest()[:24]}.job", raw)

    def write(self, path: Path, raw: bytes | memoryview) -> None:
        """Writes a file whole or not at all; raises RunFailed."""
        try:
            durable.replace(path, raw)
        except OSError as error:
            raise RunFailed(
                f"{path}: {error.strerror}; the runs finished so far are kept: make room and repeat the command"
            ) from error

    def save(self, name: str, table: pa.Table) -> None:
        """Writes one of the tables."""
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        self.write(self.data / f"{name}.parquet", memoryview(sink.getvalue()))


@dataclass(frozen=True)
class Results:
    """The tables described at the top of this module."""

    runs: pa.Table
    series: pa.Table
    trajectories: pa.Table
    weights: pa.Table

    @property
    def diverged(self) -> int:
        """How many rows of `runs` had a learner or a state leave every bound."""
        return int(np.count_nonzero(self.runs["diverged"].to_numpy(zero_copy_only=False)))


def load(out: Path) -> Results:
    """The tables a grid left in `out`.

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
    """Rows to a table; a column nobody knows anything in is a column of null floats."""
    if not rows:
        return COORDINATES.empty_table()
    table = pa.Table.from_pylist(rows, schema=pa.schema([(name, _type(name, rows)) for name in rows[0]]))
    return table


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
