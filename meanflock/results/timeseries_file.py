"""Files of a run's time series: Parquet, made from the spool at the end of the flight, and CSV.

Parquet has checksums of pages, but none of the footer, which has the layout. `_seal` adds one between the last page and
the footer, which readers of Parquet ignore.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from os import SEEK_END
from pathlib import Path
from typing import BinaryIO, Literal, TypeAlias
from zlib import crc32

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv

from meanflock.results.quantities import COLUMNS_BEFORE
from meanflock.results.series import diagnostics_in, dimensions_in, long_form, rows_of, schema
from meanflock.results.spool import spooled
from meanflock.swarm import durable, paths
from meanflock.swarm.errors import BadInput

TIMESERIES = "timeseries.parquet"
SPOOL = ".telemetry"  # in its place while the run flies, and after a kill
Per: TypeAlias = Literal["uav", "tick"]  # a row a tick and UAV, or a row a tick
_ENTRIES = 100_000  # of a CSV file: rows times UAVs that are converted at once
_NO_HEADER = csv.WriteOptions(include_header=False)
_SEAL = b"mf\x89seal\n"
_SEAL_BYTES = len(_SEAL) + 4
_TAIL_BYTES = 8  # of Parquet: the footer's length and a mark
_NEEDED = (*(column.key for column in COLUMNS_BEFORE), "status")  # columns; later versions may add others
_LONGEST_FOOTER = 2**27  # bytes
_MARK_BLOCK, _MARK_EVENTS = "meanflock.block", "meanflock.events_bytes"


@dataclass(frozen=True)
class Past:
    """Part of a flight in a run folder, to be resumed: rows of ticks 0…n, and the size of the file of events."""

    rows: pa.Table
    next_block: int  # the first block of telemetry it does not hold
    events_bytes: int


def recover(folder: Path) -> None:
    """Convert the spool of a run, finished or killed, to `timeseries.parquet`."""
    spool = folder / SPOOL
    if not spool.exists():
        return
    part = folder / f".{TIMESERIES}"
    try:
        _to_parquet(spool, part)
        durable.move(part, folder / TIMESERIES)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    durable.remove(spool)


def _to_parquet(spool: Path, path: Path) -> None:
    rows = _rows_of(spool)
    first = list(islice(rows, 1))
    columns = first[0][0].schema if first else schema(())
    rows = chain(first, rows)
    with (
        pa.OSFile(str(path), "wb") as file,  # of a path pyarrow makes a URI or a home folder
        pq.ParquetWriter(file, columns, compression="zstd", write_page_checksum=True) as writer,
    ):
        last: dict[str, str] = {}
        while blocks := list(islice(rows, 50)):
            writer.write_table(pa.Table.from_batches([batch for batch, _ in blocks], columns))
            last = blocks[-1][1]
        writer.add_key_value_metadata(last)
    _seal(path)


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read the rows of a time series, or some columns, and compare their checksums.

    Raises OSError if the file is damaged or missing.
    """
    with _reading():
        return _checked(_opened(path).read(columns))


class SeriesReader:
    """Reader of a time series that holds a part of the rows in memory at a time.

    ticks: number of rows. columns: their schema. events_bytes: size of the events that belong to the rows.
    """

    def __init__(self, path: Path) -> None:
        """Raises OSError if the file is damaged or missing."""
        with _reading():
            self._file = _opened(path)
            metadata = self._file.metadata
            self.ticks: int = metadata.num_rows
            self.columns: pa.Schema = self._file.schema_arrow
            self.events_bytes = int((metadata.metadata or {}).get(_MARK_EVENTS.encode(), 0))

    def pieces(self, ticks: int) -> Iterator[pa.Table]:
        """The rows in pieces of at most so many ticks; compares the checksums. Raises OSError if one is wrong."""
        with _reading():
            for batch in self._file.iter_batches(ticks):
                yield _checked(pa.Table.from_batches([batch]))


@contextmanager
def _reading() -> Iterator[None]:
    """Context that reads Parquet: every error becomes an OSError."""
    try:
        yield
    except (ValueError, pa.ArrowException) as error:  # what is no Parquet
        raise OSError("damaged: it is no Parquet file, or not all of one") from error
    except OSError as error:
        if error.errno is None and "damaged" not in str(error):  # of pyarrow, about a page
            raise OSError("damaged: the checksum of a page is wrong") from error
        raise


def past(folder: Path, tick: int | None = None) -> Past:
    """Read the rows of a folder: all, or up to the checkpoint of a tick.

    Raises:
        BadInput: there is no time series, or it has a gap before the tick.
    """
    try:
        if (folder / SPOOL).exists():
            read = list(_rows_of(folder / SPOOL))
            batches = [batch for batch, _ in read]
            rows = pa.Table.from_batches(batches, batches[0].schema if batches else schema(()))
            mark = read[-1][1] if read else {}
        else:
            with _reading():
                file = _opened(folder / TIMESERIES)
                rows = _checked(file.read())
                mark = {key.decode(): value.decode() for key, value in (file.metadata.metadata or {}).items()}
    except OSError as error:
        raise BadInput(f"{folder}: no time series to continue ({error})") from error
    if tick is not None:
        rows = rows.slice(0, tick + 1)
        if rows["tick"].to_pylist() != list(range(tick + 1)):
            raise BadInput(f"{folder / TIMESERIES}: rows before tick {tick} are missing; the run cannot be resumed")
    return Past(rows, int(mark.get(_MARK_BLOCK, -1)) + 1, int(mark.get(_MARK_EVENTS, 0)))


def _rows_of(spool: Path) -> Iterator[tuple[pa.RecordBatch, dict[str, str]]]:
    """The rows of every block, with the numbers of a `Past` that ends with it."""
    for block, events_bytes, dt in spooled(spool):
        yield rows_of(block, dt), {_MARK_BLOCK: str(block.block), _MARK_EVENTS: str(events_bytes)}


def _seal(path: Path) -> None:
    """Adds the checksum of the footer to a file. Raises OSError if there is no room for it."""
    with path.open("r+b") as file:
        begins, footer = _footer(file)
        file.seek(begins)
        file.write(_SEAL + crc32(footer).to_bytes(4, "little") + footer)


def _opened(path: Path) -> pq.ParquetFile:
    """A file whose footer is whole. Raises OSError if it is damaged or missing."""
    _check_seal(path)
    file = pq.ParquetFile(pa.OSFile(str(path)), page_checksum_verification=True)
    found = file.schema_arrow
    if lacking := [name for name in _NEEDED if name not in found.names]:
        raise OSError(f"damaged: it has no column {', '.join(lacking)}")
    expected = schema(diagnostics_in(found), dimensions_in(found))
    if odd := [
        field.name for field in expected if field.name in found.names and found.field(field.name).type != field.type
    ]:
        raise OSError(f"damaged: columns of a wrong type: {', '.join(odd)}")
    return file


def _checked(rows: pa.Table) -> pa.Table:
    """Rows with an entry of each UAV in every tick. Raises OSError if an entry is missing."""
    lists = [rows[field.name] for field in rows.schema if pa.types.is_list(field.type) and field.name != "leader_model"]
    counts = [np.diff(chunk.offsets.to_numpy()) for column in lists for chunk in column.chunks]
    if len(np.unique(np.concatenate([[], *counts]))) > 1 or any(column.null_count for column in lists):
        raise OSError("damaged: not every tick has an entry of each UAV")
    return rows


def _check_seal(path: Path) -> None:
    """Raises OSError if the footer is damaged; a file without a seal, of another program, passes."""
    with paths.opened(path) as file:
        begins, footer = _footer(file)
        file.seek(max(0, begins - _SEAL_BYTES))
        found = file.read(_SEAL_BYTES)
        if found[: len(_SEAL)] == _SEAL and found[len(_SEAL) :] != crc32(footer).to_bytes(4, "little"):
            raise OSError("damaged: the checksum of its footer is wrong")


def _footer(file: BinaryIO) -> tuple[int, bytes]:
    """Offset of the footer, and all bytes from there; of a file that is no Parquet any bytes."""
    size = file.seek(0, SEEK_END)
    file.seek(max(0, size - _TAIL_BYTES))
    length = int.from_bytes(file.read(4), "little")
    begins = max(0, size - _TAIL_BYTES - length)
    file.seek(begins)
    return begins, file.read(_LONGEST_FOOTER)


def write_csv(rows: pa.Table, path: Path, per: Per, progress: Callable[[int, int], None]) -> Path:
    """Writes the rows of a time series; nothing is at `path` before the last row is written.

    Floats have the digits that read back as the same float64. With a row a tick, columns of lists are left out.

    Args:
        progress: called with the ticks written and all ticks.

    Raises:
        BadInput: no file can be made there.
        RunFailed: the disk is full.
    """
    ticks, uavs = len(rows), len(rows["x_m"][0]) if len(rows) else 0
    at_once = max(1, _ENTRIES // max(1, uavs))
    with durable.replacing(path) as file:
        durable.write(file, (",".join(_flat(rows.slice(0, 0), per).column_names) + "\n").encode())
        for first in range(0, ticks, at_once):
            text = pa.BufferOutputStream()
            csv.write_csv(_flat(rows.slice(first, at_once), per), text, _NO_HEADER)
            durable.write(file, memoryview(text.getvalue()))
            progress(min(first + at_once, ticks), ticks)
    return path


def _flat(rows: pa.Table, per: Per) -> pa.Table:
    """Rows without lists. float32 becomes float64: its shortest digits would read back as another float64."""
    if per == "uav":
        flat = long_form(rows)
    else:
        flat = rows.select([field.name for field in rows.schema if not pa.types.is_list(field.type)])
    wide = [field.with_type(pa.float64()) if field.type == pa.float32() else field for field in flat.schema]
    return flat.cast(pa.schema(wide))
