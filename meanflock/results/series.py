"""The time series of a run: schema, conversion from and to telemetry, and statistics over the UAVs of each tick."""

import functools
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from meanflock.channel.meter import TRAFFIC
from meanflock.federation.plan import Plan
from meanflock.results.quantities import ACCELERATION, PHI_G, POSITION, VELOCITY, Field, check_columns, columns
from meanflock.swarm import state
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.wire.messages import SWARM_COLUMNS, LinkColumn, Status, Telemetry, has_or_none

COLUMN = {name: index for index, name in enumerate(SWARM_COLUMNS)}  # of `Telemetry.swarm`
BITS_SENT = [COLUMN[f"{name}_bits"] for name in TRAFFIC.values()]
MOST_LINES = 60  # of the plot of a model's weights


class Reported(NamedTuple):
    """Reports of a flight. diagnostics: names of the numbers of every UAV and tick. weights: numbers of a model."""

    diagnostics: tuple[str, ...]
    weights: int

    @classmethod
    def by(cls, plan: Plan) -> "Reported":
        """The reports that controller and vehicle declare."""
        return cls(plan.columns, plan.declared.weights)

    @classmethod
    def within(cls, rows: pa.Table) -> "Reported":
        """The reports in a time series; its controller need not be installed."""
        models = rows["leader_model"].drop_null()
        return cls(diagnostics_in(rows.schema), len(models[0]) if len(models) else 0)

    @property
    def drawn(self) -> NDArray[np.intp]:
        """Indices of the weights that are drawn: all, or some at even distances."""
        return np.unique(np.linspace(0, self.weights - 1, min(self.weights, MOST_LINES)).round().astype(np.intp))

    @property
    def has_phi_g(self) -> bool:
        """Returns whether paths are coloured by φ_G; else they are coloured by speed."""
        return PHI_G in self.diagnostics


@functools.cache
def schema(diagnostics: tuple[str, ...], dimensions: int = state.PLANE) -> pa.Schema:
    """Columns of `timeseries.parquet`: a row a tick; lists have an entry a UAV. `diagnostics`: of
    controller and vehicle."""
    return pa.schema([_arrow(column) for column in columns(diagnostics, dimensions)])


def check_reports(plan: Plan) -> None:
    """Raises BadInput if a diagnostic of the controller or a column of the vehicle is called like another column."""
    check_columns(f"controller {plan.scenario.method!r}: `diagnostics`", plan.declared.diagnostics)
    check_columns(f"vehicle {plan.scenario.vehicle.model!r}: `columns`", plan.shown)


def _arrow(column: Field) -> pa.Field:
    """A column in Arrow, with its meaning as metadata."""
    metadata = {"description": column.about, "unit": column.unit, "cumulative": str(column.cumulative).lower()}
    if column.key == "status":
        metadata["values"] = status_names()
    number = pa.type_for_alias(column.type.removesuffix("[]"))
    return pa.field(column.key, pa.list_(number) if column.type.endswith("[]") else number, metadata=metadata)


def status_names() -> str:
    """The numbers of a status and their names."""
    return ", ".join(f"{status.value} {status.name.lower()}" for status in Status)


def rows_of(block: Telemetry, dt: float) -> pa.RecordBatch:
    """The rows of a block; a tick takes `dt` seconds. A diagnostic that a UAV does not have is null."""
    rows, uavs, _ = block.states.shape
    ticks = np.arange(block.first_tick, block.first_tick + rows, dtype=np.int32)

    def lists(values: np.ndarray, has: NDArray[np.uint8] | None = None) -> list[pa.Array]:
        """Columns of lists, of values (T, N, columns); null where `has`, (N, columns) or of each row, is 0."""
        each = _columns(values)  # one copy for all of them
        nulls = [None] * len(each) if has is None else _columns(np.broadcast_to(has == 0, values.shape))
        columns = [pa.array(column, mask=mask) for column, mask in zip(each, nulls, strict=True)]
        return [pa.ListArray.from_arrays(offsets, column) for column in columns]

    offsets = pa.array(np.arange(0, rows * uavs + 1, uavs, dtype=np.int32))
    report_of = dict(zip(block.report_ticks.tolist(), range(len(block.report_ticks)), strict=True))
    reported = [report_of.get(tick) for tick in ticks.tolist()]
    return pa.RecordBatch.from_arrays(
        [
            pa.array(ticks),
            pa.array(ticks * dt),
            *lists(block.states),
            *lists(block.accelerations),
            *lists(block.energy[..., None]),
            *lists(block.diagnostics, block.has_diagnostic),
            *lists(block.status[..., None]),
            *map(pa.array, np.ascontiguousarray(block.swarm.T)),
            pa.array([None if k is None else block.spread[k] for k in reported], pa.float64()),
            pa.array([None if k is None else block.reports[k] for k in reported], pa.list_(pa.float32())),
        ],
        schema=schema(block.diagnostic_names, state.axes(block.states)),
    )


def _columns(values: NDArray[Any]) -> NDArray[Any]:
    """Values (T, N, columns) as (columns, T · N)."""
    rows, uavs, columns = values.shape
    return np.moveaxis(values, -1, 0).reshape(columns, rows * uavs)


def block_of(rows: pa.Table, number: int, events: tuple[FlightEvent, ...] = ()) -> Telemetry:
    """Rows of ticks that follow each other as a block; links and checkpoint are not in them."""
    reported = rows.filter(rows["leader_model"].is_valid())
    reports = reported["leader_model"].to_pylist()
    names = diagnostics_in(rows.schema)
    diagnostics = per_uav(rows, *names) if names else np.zeros((len(rows), len(rows["x_m"][0]), 0), np.float32)
    return Telemetry(
        run=0,
        block=number,
        first_tick=rows["tick"][0].as_py(),
        states=states_of(rows),
        accelerations=per_uav(rows, *ACCELERATION[: dimensions_in(rows.schema)]),
        diagnostics=np.nan_to_num(diagnostics),
        status=per_uav(rows, "status")[..., 0],
        energy=per_uav(rows, "energy_J")[..., 0],
        swarm=np.stack([rows[name].to_numpy() for name in SWARM_COLUMNS], axis=-1),
        links=np.zeros((0, len(LinkColumn)), dtype=np.int32),
        report_ticks=reported["tick"].to_numpy(),
        reports=np.array(reports, dtype=np.float32).reshape(len(reports), -1 if reports else 0),
        spread=reported["weight_spread"].to_numpy(),
        events=events,
        diagnostic_names=names,
        has_diagnostic=has_or_none(~np.isnan(diagnostics)),
    )


def diagnostics_in(columns: pa.Schema) -> tuple[str, ...]:
    """Names of the diagnostics in a time series: the columns between energy and status."""
    names = columns.names
    return tuple(names[names.index("energy_J") + 1 : names.index("status")])


def dimensions_in(columns: pa.Schema) -> int:
    """Number of axes of the flight of a time series."""
    return state.SPACE if POSITION[-1] in columns.names else state.PLANE


def unbroken(rows: pa.Table, at_most: int) -> Iterator[pa.Table]:
    """`rows` in pieces of ticks that follow each other, none longer than `at_most`."""
    gaps = np.flatnonzero(np.diff(rows["tick"].to_numpy()) != 1) + 1
    cuts = sorted({*range(0, len(rows), at_most), *gaps.tolist(), len(rows)})
    for begin, end in pairwise(cuts):
        yield rows.slice(begin, end - begin)


def long_form(rows: pa.Table) -> pa.Table:
    """A time series with a row a tick and UAV: tick, sim_time_s, uav, and each column that has an entry a UAV.

    Columns of the swarm, and `leader_model`, are not in it.
    """
    lists = [field for field in rows.schema if pa.types.is_list(field.type) and field.name != "leader_model"]
    uavs = len(rows["x_m"][0]) if len(rows) else 0
    ticks = pa.array(np.repeat(np.arange(len(rows)), uavs))
    shared = rows.select(["tick", "sim_time_s"]).take(ticks)
    fields = [*shared.schema, pa.field("uav", pa.int32()), *(field.with_type(field.type.value_type) for field in lists)]
    numbers = np.tile(np.arange(uavs, dtype=np.int32), len(rows))
    values = [rows[field.name].combine_chunks().flatten() for field in lists]
    return pa.table([*shared.columns, numbers, *values], schema=pa.schema(fields))


def states_of(rows: pa.Table) -> NDArray[np.float64]:
    """The states (T, N, 2d) in rows of a time series."""
    d = dimensions_in(rows.schema)
    return per_uav(rows, *POSITION[:d], *VELOCITY[:d])


def per_uav(rows: pa.Table, *names: str) -> NDArray[Any]:
    """Columns of a time series that have an entry a UAV, (T, N, columns); NaN where an entry is null."""
    columns = [rows[name].combine_chunks() for name in names]
    flat = [
        (column.flatten() if isinstance(column, pa.ListArray) else column).to_numpy(zero_copy_only=False)
        for column in columns
    ]
    return np.stack(flat, axis=-1).reshape(len(rows), -1, len(columns))


def span(values: NDArray[Any]) -> NDArray[np.float64]:
    """Mean, minimum and maximum over the UAVs: (T, N) to (T, 3)."""
    lines = np.empty((len(values), 3))
    values.mean(axis=1, dtype=np.float64, out=lines[:, 0])
    columns = np.ascontiguousarray(values.T)  # much faster than minima along the rows
    lines[:, 1], lines[:, 2] = columns.min(axis=0), columns.max(axis=0)
    return lines


def span_where(values: NDArray[Any], chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Mean, minimum and maximum over the UAVs `chosen` (T, N): (T, 3); NaN in ticks without one. A tick has the same
    bits in every batch.
    """
    if chosen.all():
        return span(values)
    lines, some = np.full((len(values), 3), np.nan), chosen.any(axis=1)
    values, chosen = values[some], chosen[some]
    mean = np.where(chosen, values, 0).sum(axis=1, dtype=np.float64) / np.count_nonzero(chosen, axis=1)
    low, high = np.where(chosen, values, np.inf).min(axis=1), np.where(chosen, values, -np.inf).max(axis=1)
    lines[some] = np.stack([mean, low, high], axis=-1)
    return lines


def log_sizes(values: NDArray[np.float32]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """The ticks that have a residual, (T,), and log10 of its largest and mean size there, (R, 2).

    A residual of exactly 0 was not computed: before the first step, or of a lost UAV. It counts for nothing.
    """
    size = np.abs(values.astype(np.float64))
    some = size > 0
    computed: NDArray[np.bool_] = np.any(some, axis=1)
    if not computed.all():
        size, some = size[computed], some[computed]
    mean = size.sum(axis=1) / np.count_nonzero(some, axis=1)
    largest = np.ascontiguousarray(size.T).max(axis=0)
    lines: NDArray[np.float64] = np.log10(np.stack([largest, mean], axis=-1))
    return computed, lines
