"""Spool of a flight: a file of telemetry blocks, from which the time series is made at the end.

Writing a block takes a tenth of the time of converting it to columns. The columns are made after the flight, from all
complete blocks. A kill cuts off the end of this file only; a Parquet file would be lost.
"""

import logging
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import msgspec
import numpy as np

from meanflock.results import inbound
from meanflock.swarm import durable, paths
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import LinkColumn, Telemetry

log = logging.getLogger("meanflock.spool")

_SIGNATURE = b"mf\x89spool"
_HEAD = struct.Struct("<IQdII")  # of a block: its bytes, the rest of `Spooled`, CRC-32 of the block and of all this
_CHECKSUM = 4  # bytes
_NO_LINKS = np.zeros((0, len(LinkColumn)), dtype=np.int32)


class Spooled(NamedTuple):
    """A block of the file."""

    block: Telemetry  # its rows alone
    events_bytes: int  # where the events of it and all before it end
    dt: float  # of a tick, s


class Spool:
    """Writer of the file; written blocks survive a kill of the process."""

    def __init__(self, path: Path, dt: float) -> None:
        """Create the file, or replace it."""
        self._file, self._dt = path.open("wb", buffering=0), dt
        durable.write(self._file, _SIGNATURE)

    def append(self, block: Telemetry, events_bytes: int) -> None:
        """Append the rows of a block, completely or not at all. Raises OSError if there is no room."""
        rows = control.encode(msgspec.structs.replace(block, links=_NO_LINKS, events=(), checkpoint=b""))
        before = self._file.tell()
        try:
            head = _HEAD.pack(len(rows), events_bytes, self._dt, crc32(rows), 0)[:-_CHECKSUM]
            durable.write(self._file, head + crc32(head).to_bytes(_CHECKSUM, "little"))
            durable.write(self._file, rows)
        except OSError:
            self._file.seek(before)
            self._file.truncate()
            raise

    def fileno(self) -> int:
        """The handle of the file."""
        return self._file.fileno()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def spooled(path: Path) -> Iterator[Spooled]:
    """Read all complete blocks. A block with a wrong checksum is left out with a warning, and so is the rest if block
    limits are lost. Raises OSError without a file.
    """
    with paths.opened(path) as file:
        if file.read(len(_SIGNATURE)) != _SIGNATURE:
            _warn(path, 0, "all of it is left out")
            return
        while len(head := file.read(_HEAD.size)) == _HEAD.size:
            begins = file.tell() - _HEAD.size
            size, events_bytes, dt, of_rows, of_head = _HEAD.unpack(head)
            if crc32(head[:-_CHECKSUM]) != of_head:
                _warn(path, begins, "all from there on is left out")
                return
            if size > paths.LOG_BYTES:
                _warn(path, begins, "all from there on is left out")
                return
            if len(rows := file.read(size)) < size:
                return
            if crc32(rows) != of_rows:
                _warn(path, begins, f"{size} bytes of rows are left out")
            elif (block := _block(rows)) is None:
                _warn(path, begins, "all from there on is left out")
                return
            else:
                yield Spooled(block, events_bytes, dt)


def _block(rows: bytes) -> Telemetry | None:
    """Decode a block; None if it is invalid."""
    try:
        block = control.decode(rows)
        if isinstance(block, Telemetry):
            inbound.check(block, None)
            return block
    except MessageRejected:
        pass
    return None


def _warn(path: Path, begins: int, consequence: str) -> None:
    log.warning("%s: damaged at byte %d: %s", path, begins, consequence)
