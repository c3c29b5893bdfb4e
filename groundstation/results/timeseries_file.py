"""The file of a run's time series: made of the spool when the flight is over, and read when it goes on."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from meanflock.groundstation.results import seal
from meanflock.groundstation.results.series import rows_of, schema
from meanflock.groundstation.results.spool import spooled
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput

TIMESERIES = "timeseries.parquet"
SPOOL = ".telemetry"  # in its place while the run flies, and after a kill
_MARK_BLOCK, _MARK_EVENTS = "meanflock.block", "meanflock.events_bytes"


@dataclass(frozen=True)
class Past:
    """What a run folder holds of a flight that is to go on: rows of ticks 0…n, and up to where its events belong."""

    rows: pa.Table
    next_block: int  # the first block of telemetry it does not hold
    events_bytes: int


def recover(folder: Path) -> None:
    """Turns what a run has spooled, to its end or to where it was killed, into `timeseries.parquet`."""
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
    with pq.ParquetWriter(path, columns, compression="zstd", write_page_checksum=True) as writer:
        last: dict[str, str] = {}
        while blocks := list(islice(rows, 50)):
            writer.write_table(pa.Table.from_batches([batch for batch, _ in blocks], columns))
            last = blocks[-1][1]
        writer.add_key_value_metadata(last)
    seal.seal(path)


def read_table(path: Path) -> pa.Table:
    """The rows of a time series, all checksums compared. Raises OSError where it is damaged or not there."""
    try:
        seal.check(path)
        return pq.read_table(path, page_checksum_verification=True)
    except (ValueError, pa.ArrowException) as error:  # what is no Parquet
        raise OSError("damaged: it is no Parquet file, or not all of one") from error
    except OSError as error:
        if error.errno is None and "damaged" not in str(error):  # of pyarrow, about a page
            raise OSError("damaged: the checksum of a page is wrong") from error
        raise


def past(folder: Path, tick: int | None = None) -> Past:
    """What a folder holds: all of it, or up to the checkpoint of a tick.

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
            rows = read_table(folder / TIMESERIES)
            mark = {k.decode(): v.decode() for k, v in (pq.read_metadata(folder / TIMESERIES).metadata or {}).items()}
    except OSError as error:
        raise BadInput(f"{folder}: no time series to go on from ({error})") from error
    if tick is not None:
        rows = rows.slice(0, tick + 1)
        if rows["tick"].to_pylist() != list(range(tick + 1)):
            raise BadInput(f"{folder / TIMESERIES}: rows before tick {tick} are missing; the run cannot be resumed")
    return Past(rows, int(mark.get(_MARK_BLOCK, -1)) + 1, int(mark.get(_MARK_EVENTS, 0)))


def _rows_of(spool: Path) -> Iterator[tuple[pa.RecordBatch, dict[str, str]]]:
    """The rows of every block, with what is to be known of the folder that ends with it."""
    for block, events_bytes, dt in spooled(spool):
        yield rows_of(block, dt), {_MARK_BLOCK: str(block.block), _MARK_EVENTS: str(events_bytes)}
