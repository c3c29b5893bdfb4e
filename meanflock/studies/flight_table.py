"""The flights of a study as a tidy table: a row for each flight, with every figure of its summary."""

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from meanflock.results.quantities import SUMMARY
from meanflock.results.stored_run import unit_of
from meanflock.swarm import durable

_LINKS = "radio.links"  # a list
_TABLES = frozenset(field.key.rpartition(".")[0] for field in SUMMARY)  # fields that have fields, such as `realtime`


def flight_table(names: Sequence[str], points: Mapping[tuple[Any, ...], Sequence[Mapping[str, Any]]]) -> pa.Table:
    """A row for each flight: the varied values, then all fields of the summary under their dotted keys.

    Unknown values are null. The list `radio.links` is left out. Values that are lists or tables are JSON.

    Args:
        names: names of the varied values. points: the values of a point → the summaries of its flights.
    """
    rows = [
        dict(zip(names, map(_plain, values), strict=True)) | dict(_fields(summary))
        for values, summaries in points.items()
        for summary in summaries
    ]
    columns = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: _column(name, [row.get(name) for row in rows]) for name in columns})


def write_tables(table: pa.Table, out: Path) -> list[Path]:
    """Write the table as `out`/flights.csv and `out`/flights.parquet; raises as `write_csv`."""
    return [write_csv(table, out / "flights.csv"), write_parquet(table, out / "flights.parquet")]


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
        elif prefix + key != _LINKS and not (value is None and prefix + key in _TABLES):
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
