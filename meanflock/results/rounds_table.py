"""The rounds of a run as a table, a row each: what was sent and received, what it cost, and how well the UAVs flew."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from meanflock.results.event_log import event_of_row, stored_lines
from meanflock.results.quantities import quantity
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import RoundEnded

ROUNDS = "rounds.parquet"
_NAME = str(RoundEnded.__struct_config__.tag).encode()  # in every line about a round
NO_ROUNDS = "no rounds; fly a method that shares a model, as mfgfl-hf does, until a round ends"  # of a run without any
MEAN, METRIC = "mean_", "metric_"  # begin the names of columns

COLUMNS: dict[str, tuple[pa.DataType, str]] = {  # type and description
    "round": (pa.int32(), "number of the round, from 1"),
    "tick": (pa.int32(), "tick in which it ended: its uploads were averaged, or could not be"),
    "sim_time_s": (pa.float64(), "simulated time of that tick, s"),
    "opened_s": (pa.float64(), "simulated time at which its uploads began, s"),
    "outcome": (pa.string(), "`averaged`, `waiting` (the rule waits for more models) or `void`"),
    "reason": (pa.string(), "why it is void; else empty"),
    "participants": (pa.int32(), "UAVs that were to upload"),
    "absent": (pa.int32(), "of them, those that were lost or paused"),
    "silent": (pa.int32(), "of them, those that were there and sent nothing"),
    "sent": (pa.int32(), "UAVs that uploaded"),
    "received": (pa.int32(), "UAVs whose upload, or a part of it, arrived in time"),
    "late": (pa.int32(), "UAVs whose upload came after the round was averaged"),
    "lost": (pa.int32(), "UAVs whose upload never arrived"),
    "refused": (pa.int32(), "UAVs whose upload arrived and could not be averaged"),
    "copies": (pa.int32(), "messages over links to other UAVs; a model in fragments is one for each"),
    "earlier": (pa.int32(), "late uploads of the round before that count in this one"),
    "averaging": (pa.int32(), "UAVs that averaged for themselves; null if a leader averages"),
    "isolated": (pa.int32(), "UAVs that average for themselves and received nothing"),
    "fragments": (pa.int32(), "fragments in which the average was broadcast; 1: it was whole"),
    "reached": (pa.int32(), "UAVs that received the average; null if it went in fragments, again or by no radio"),
    "retries": (pa.int32(), "uploads that were transmitted again"),
    "bits": (pa.int64(), "payload bits of all traffic since take-off"),
    "airtime_s": (pa.float64(), "airtime of all traffic since take-off, s"),
}
OVER = {  # what a learning curve is drawn over, and its column
    "rounds": "round",
    "seconds": "sim_time_s",
    "bits": "bits",
    "airtime": "airtime_s",
}

OF_UAVS = (  # of which UAVs the means of diagnostics are
    "Diagnostics are means over the UAVs on the way when the round ended, those of trainings over the UAVs whose last "
    "training gave all metrics."
)


def column_heading(column: str) -> str:
    """The heading of a mean or a metric in a narrow column, line by line, with its unit."""
    measured = quantity(column.removeprefix(METRIC).removeprefix(MEAN))
    unit = "share" if measured.share else measured.unit
    return (measured.heading or measured.name) + (f"\n({unit})" if unit else "")


def rounds_table(rounds: Iterable[RoundEnded], dt: float) -> pa.Table:
    """The table of some rounds, in their order; a tick takes `dt` seconds.

    After the columns of `COLUMNS` come `mean_…`, the means of the diagnostics at the end of the round over the UAVs on
    the way, and `metric_…`, what the learners report; null where there is none.
    """
    return table_of_rows([row_of_round(each, dt) for each in rounds])


def table_of_rows(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """The table of rows of `row_of_round`, without other columns that they have."""
    schema = [pa.field(name, kind) for name, (kind, _) in COLUMNS.items()]
    more = dict.fromkeys(name for row in rows for name in row if name.startswith((MEAN, METRIC)))
    schema += [pa.field(name, pa.float64()) for name in more]
    return pa.Table.from_pylist(rows, schema=pa.schema(schema))


def stored_rounds(events: Path) -> list[RoundEnded]:
    """The rounds in a file of events.

    Raises:
        BadInput: the file cannot be read, or a round in it is damaged.
    """
    try:
        found = (event_of_row(json.loads(line)) for line in stored_lines(events) if _NAME in line)
        return [event for event in found if isinstance(event, RoundEnded)]
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise BadInput(f"{events}: damaged: {error}; fly the run again") from error


def write_rounds(folder: Path, events: Path, dt: float) -> None:
    """Write the rounds of a run, completely or not at all, if there were any. Raises OSError if there is no room."""
    if rounds := stored_rounds(events):
        table = pa.BufferOutputStream()
        pq.write_table(rounds_table(rounds, dt), table)
        durable.replace(folder / ROUNDS, memoryview(table.getvalue()))


def row_of_round(ended: RoundEnded, dt: float) -> dict[str, Any]:
    """A row of the table: numbers of COLUMNS, means of diagnostics and metrics."""
    row = {
        "round": ended.number,
        "tick": ended.tick,
        "sim_time_s": round(ended.tick * dt, 6),
        "opened_s": round(ended.opened * dt, 6),
    }
    for name in COLUMNS:
        if name not in row:
            value = getattr(ended, name)
            row[name] = len(value) if isinstance(value, tuple) else value
    row |= {f"{MEAN}{name}": value for name, value in ended.diagnostics.items()}
    return row | {f"{METRIC}{name}": value for name, value in ended.metrics.items()}
