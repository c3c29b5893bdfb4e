"""The flights of a study as tidy tables: a row for each flight, with every figure of its summary, or each round."""

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from meanflock.results.quantities import SUMMARY
from meanflock.results.rounds_table import table_of_rows
from meanflock.results.stored_run import unit_of
from meanflock.studies.each_round import EACH_ROUND
from meanflock.studies.failure_reasons import FAILURES
from meanflock.swarm import durable

FLIGHTS, FLIGHTS_CSV, ROUNDS = TABLES = "flights.parquet", "flights.csv", "rounds.parquet"  # files of a study
_LEFT_OUT = ("radio.links", EACH_ROUND, FAILURES)  # lists
_OF_A_FLIGHT = ("method", "learner", "seed")  # what tells flights apart beside the varied values
_TABLES = frozenset(field.key.rpartition(".")[0] for field in SUMMARY)  # fields that have fields, such as `realtime`

Points = Mapping[tuple[Any, ...], Sequence[Mapping[str, Any]]]


def flight_table(names: Sequence[str], points: Points) -> pa.Table:
    """A row for each flight: the varied values, then all fields of the summary under their dotted keys.

    Unknown values are null. The list `radio.links` is left out. Values that are lists or tables are JSON. The metadata
    of a column has its unit.

    Args:
        names: names of the varied values. points: the values of a point → the summaries of its flights.
    """
    rows = [
        dict(zip(names, map(_plain, values), strict=True)) | dict(_fields(summary))
        for values, summaries in points.items()
        for summary in summaries
    ]
    columns = dict.fromkeys(name for row in rows for name in row)
    arrays = {name: _column(name, [row.get(name) for row in rows]) for name in columns}
    units = {name: {"unit": unit} for name in columns if (unit := unit_of(name))}
    fields = [pa.field(name, array.type, metadata=units.get(name)) for name, array in arrays.items()]
    return pa.table(list(arrays.values()), schema=pa.schema(fields))


def rounds_table(names: Sequence[str], points: Points) -> pa.Table:
    """A row for each round of each flight: the varied values, method, learner if there is one, seed, and the round.

    Arguments as for `flight_table`.
    """
    rounds, known = [], []
    for values, summaries in points.items():
        varied = dict(zip(names, map(_plain, values), strict=True))
        for summary in summaries:
            own = {name: summary[name] for name in _OF_A_FLIGHT if name in summary}
            rounds += summary[EACH_ROUND]
            known += [varied | own] * len(summary[EACH_ROUND])
    columns = dict.fromkeys(name for one in known for name in one)
    table = table_of_rows(rounds)
    for place, name in enumerate(columns):
        table = table.add_column(place, name, _column(name, [one.get(name) for one in known]))
    return table


def write_tables(names: Sequence[str], points: Points, out: Path) -> list[Path]:
    """Write the flights as `out`/flights.csv and flights.parquet, and the rounds, if there are any, as rounds.parquet.

    Arguments as for `flight_table`; raises as `write_csv`.
    """
    flights, rounds = flight_table(names, points), rounds_table(names, points)
    written = [write_csv(flights, out / FLIGHTS_CSV), write_parquet(flights, out / FLIGHTS)]
    return [*written, write_parquet(rounds, out / ROUNDS)] if rounds.num_rows else written


def write_csv(table: pa.Table, path: Path) -> Path:
    """Write the table as CSV; an empty cell is unknown. Floats read back as the same float64.

    Raises:
        BadInput: no file can be made there.
        RunFailed: the disk is full.
    """
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(table.column_names)
    lines.writerows(zip(*(column.to_pylist() for column in table.columns), strict=True))
    return _write(path, text.getvalue().encode())


def write_parquet(table: pa.Table, path: Path) -> Path:
    """Write the table as a Parquet file; raises as `write_csv`."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return _write(path, memoryview(sink.getvalue()))


def _write(path: Path, content: bytes | memoryview) -> Path:
    with durable.replacing(path) as file:
        durable.write(file, content)
    return path


def _fields(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of a summary, without tables that are null."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{prefix}{key}.")
        elif prefix + key not in _LEFT_OUT and not (value is None and prefix + key in _TABLES):
            yield prefix + key, value


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float) else json.dumps(value, ensure_ascii=False)


def _column(name: str, values: list[Any]) -> pa.Array:
    """A column of the narrowest type that has all values; text if they are of several types."""
    kinds = {type(value) for value in values if value is not None}
    for types, kind in (({bool}, pa.bool_()), ({int}, pa.int64()), ({int, float}, pa.float64())):
        if kinds <= types and kinds:
            return pa.array(values, kind)
    if not kinds and unit_of(name):
        return pa.array(values, pa.float64())
    return pa.array([None if value is None else str(value) for value in values], pa.string())
