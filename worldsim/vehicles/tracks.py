"""Tracks: places of UAVs over time, read from a Parquet or CSV file, checked row by row, and interpolated."""

import hashlib
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import paths, state
from meanflock.swarm.errors import BadInput, available, printable
from meanflock.swarm.state import Floats

FORMATS = {".parquet": "Parquet", ".csv": "CSV"}
TIME, UAV, PLACE = "t_s", "uav", ("x_m", "y_m", "z_m")
_ROW_BYTES = 250  # of a row while it is read and checked
_FARTHEST_M = 1e8
_LONGEST_S = 1e12


class TraceRows(NamedTuple):
    """The rows of a file. times: (R,), s. uavs: (R,), numbers. places: (R, d), m."""

    times: Floats
    uavs: NDArray[np.int64]
    places: Floats


class StepBounds(NamedTuple):
    """What two rows of a UAV, one after the other, may differ by. gap_s: None: any time."""

    speed_m_s: float
    gap_s: float | None


class Tracks:
    """Places of N UAVs over time, between two rows on the straight line."""

    def __init__(self, table: TraceRows, begin_s: float) -> None:
        """`table`: valid rows, see `check`. `begin_s`: time of the table that is 0 here."""
        order = np.argsort(table.uavs, kind="stable")
        self._times, self._places = table.times[order] - begin_s, table.places[order]
        counts = np.bincount(table.uavs)
        self._last = np.cumsum(counts) - 1
        self._first = self._last - counts + 1
        self._halvings = int(counts.max()).bit_length()

    def at(self, uavs: NDArray[np.int64], times: Floats) -> state.Vectors:
        """Places (M, d) of some UAVs (M,) at times (M,), s. They wait at their first rows and stay at their last."""
        low, high = self._first[uavs], self._last[uavs]
        for _ in range(self._halvings):  # to the last row that is not later, or the first
            middle = (low + high + 1) // 2
            is_later = self._times[middle] > times
            low, high = np.where(is_later, low, middle), np.where(is_later, np.maximum(middle - 1, low), high)
        after = np.minimum(low + 1, self._last[uavs])
        span = self._times[after] - self._times[low]
        share = np.divide(times - self._times[low], span, out=np.zeros(len(times)), where=span > 0.0)
        share = np.clip(share, 0.0, 1.0)[:, None]
        return self._places[low] + share * (self._places[after] - self._places[low])


def stamp(path: Path) -> tuple[int, ...]:
    """Numbers that change with the content of a file; empty if there is none."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def read(path: Path, axes: int) -> tuple[TraceRows, str]:
    """The rows of a file with places of `axes` numbers, and the SHA-256 of the file.

    Raises:
        BadInput: it cannot be read, or a column is missing or has a value that is not a number.
    """
    if path.suffix not in FORMATS:
        raise BadInput(f"trace {path}: the format is unknown; give a file whose name ends in {' or '.join(FORMATS)}")
    try:
        content = paths.read(path, paths.LOG_BYTES)
    except OSError as error:
        raise BadInput(
            f"trace {path}: {error.strerror}; name a file of this machine in `vehicle.options.file`, from "
            f"the working folder {Path.cwd()} on or with its whole path"
        ) from error
    with available("vehicle 'trace'", "fly"):
        import pyarrow as pa
    names = (TIME, UAV, *PLACE[:axes])
    try:
        columns = _columns(content, path.suffix, names, axes)
    except pa.ArrowException as error:
        raise BadInput(f"trace {path}: {printable(str(error))}; give a valid {FORMATS[path.suffix]} file") from error
    except ValueError as error:
        raise BadInput(f"trace {path}: {error}") from error
    times, uavs, *places = columns
    return TraceRows(times, uavs.astype(np.int64), np.stack(places, axis=-1)), hashlib.sha256(content).hexdigest()


def _columns(content: bytes, suffix: str, names: tuple[str, ...], axes: int) -> list[Floats]:
    """The columns of a file; raises ValueError or ArrowException."""
    import pyarrow as pa

    source = pa.BufferReader(content)
    if suffix == ".csv":
        from pyarrow import csv

        with csv.open_csv(source) as opened:
            found = opened.schema.names
        _check_header(found, names, axes)
        _check_memory(content.count(b"\n"))
        chosen = csv.ConvertOptions(include_columns=names)
        table = csv.read_csv(pa.BufferReader(content), convert_options=chosen)
    else:
        from pyarrow import parquet

        opened = parquet.ParquetFile(source)
        _check_header(opened.schema_arrow.names, names, axes)
        _check_memory(opened.metadata.num_rows)
        table = opened.read(columns=list(names))
    if not table.num_rows:
        raise ValueError("it has no rows; give each UAV one at least")
    return [_numbers(table.column(name), name) for name in names]


def _check_header(found: list[str], names: tuple[str, ...], axes: int) -> None:
    if missing := [name for name in names if name not in found]:
        remedy = f"it needs {', '.join(names)}, and has {', '.join(map(repr, found)) or 'none'}"
        if missing == [PLACE[-1]]:
            remedy = f"add it, or set `space.dimensions` {axes} to {state.PLANE}"
        raise ValueError(f"it has no column {' and no '.join(missing)}; {remedy}")
    if twice := [name for name in names if found.count(name) > 1]:
        raise ValueError(f"it has the column {twice[0]} {found.count(twice[0])} times; leave the others out")
    if axes == state.PLANE and PLACE[-1] in found:
        raise ValueError(
            f"it has a column {PLACE[-1]}, and the flight is in the plane; set `space.dimensions` to {state.SPACE}, or "
            "leave the column out"
        )


def _check_memory(rows: int) -> None:
    most = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if (needed := rows * _ROW_BYTES) > most:
        raise ValueError(
            f"it has {rows:,} rows, which need {needed / 2**30:,.0f} GiB, and this machine has {most / 2**30:,.0f} "
            "GiB; keep fewer rows"
        )


def _numbers(column: Any, name: str) -> Floats:
    """A column as float64; raises ValueError if a value is no finite number, or no whole number of a UAV."""
    import pyarrow as pa

    if column.null_count or not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        for row, value in enumerate(column.to_pylist(), 1):
            if not _is_number(value):
                raise ValueError(
                    f"row {row}: `{name}` is {_shown(value)}; give a number{' of seconds' * (name == TIME)}"
                )
        raise ValueError(f"`{name}` is a column of {column.type}; give numbers")
    values: Floats = column.to_numpy().astype(np.float64)
    _refuse(~(np.abs(values) < np.inf), values, name, "give a finite number")
    if name == UAV:
        _refuse((values != np.floor(values)) | (values < 0.0) | (values >= 2**31), values, name, "number UAVs from 0")
    elif name == TIME:
        _refuse(~(np.abs(values) < _LONGEST_S), values, name, f"no time is {_LONGEST_S:g} s away; give seconds")
    else:
        _refuse(~(np.abs(values) < _FARTHEST_M), values, name, f"no place is {_FARTHEST_M:g} m away")
    return values


def _is_number(value: Any) -> bool:
    try:
        return value is not None and bool(float(value) == float(value))
    except (TypeError, ValueError):
        return False


def _shown(value: Any) -> str:
    return "empty or NaN" if value is None else repr(value if isinstance(value, str) else str(value))


def _refuse(bad: NDArray[np.bool_], values: Floats, name: str, remedy: str) -> None:
    if bad.any():
        row = int(bad.argmax())
        raise ValueError(f"row {row + 1}: `{name}` is {values[row]:g}; {remedy}")


def check(table: TraceRows, uavs: int, bounds: StepBounds) -> None:
    """Check that the rows are tracks of so many UAVs. Rows are counted from 1, without the header.

    Raises:
        ValueError: they are not; the message has the first row that is wrong.
    """
    numbers = np.unique(table.uavs)
    if not np.array_equal(numbers, np.arange(len(numbers))):
        row = int((table.uavs >= len(numbers)).argmax())
        raise ValueError(
            f"row {row + 1}: `{UAV}` is {table.uavs[row]}, and there are {len(numbers)} UAVs; number them "
            f"0…{len(numbers) - 1}"
        )
    if len(numbers) != uavs:
        raise ValueError(
            f"it has {len(numbers)} UAVs, and {uavs} fly; set `uavs`, or the `count` of the group, to {len(numbers)}"
        )
    if table.places.shape[1] == state.SPACE:
        height = table.places[:, -1]
        _refuse(height < 0.0, height, PLACE[-1], "the ground is at z = 0: raise all heights")
    order = np.argsort(table.uavs, kind="stable")
    before, after = order[:-1], order[1:]
    same = table.uavs[before] == table.uavs[after]
    before, after = before[same], after[same]
    elapsed = table.times[after] - table.times[before]
    apart = state.length(table.places[after] - table.places[before])
    gap_s = np.inf if bounds.gap_s is None else bounds.gap_s
    bad = (elapsed <= 0.0) | (elapsed > gap_s) | (apart > bounds.speed_m_s * elapsed)
    if not bad.any():
        return
    first = int(np.where(bad, after, len(order)).argmin())
    row, passed, last = after[first], elapsed[first], before[first] + 1
    where = f"row {row + 1}: `{TIME}` of UAV {table.uavs[row]}"
    if passed == 0.0:
        raise ValueError(f"{where} is {table.times[row]:.12g} s, as in row {last}; keep one of the rows")
    if passed < 0.0:
        raise ValueError(f"{where} is {-passed:g} s before that of row {last}; sort the rows by {TIME}")
    if passed > gap_s:
        raise ValueError(
            f"{where} is {passed:g} s after row {last}, more than `vehicle.options.gap_s` {gap_s:g} s; raise it, or "
            "add the rows between"
        )
    raise ValueError(
        f"row {row + 1}: `{'`, `'.join(PLACE[: table.places.shape[1]])}`: UAV {table.uavs[row]} is {apart[first]:g} m "
        f"from row {last} after {passed:g} s, {apart[first] / passed:g} m/s, and the bound is {bounds.speed_m_s:g} "
        "m/s; raise `vehicle.options.speed_max_m_s`, or mend the row"
    )
