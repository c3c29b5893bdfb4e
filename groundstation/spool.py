"""A flight on its way to the time series: blocks of telemetry as they came, one after the other in a file.

To write a block down takes a tenth of what it takes to make columns of it. These are made when the flight is over, of
all blocks that are whole: a kill cuts off the end of this file, and would leave nothing of a Parquet file.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from meanflock.groundstation import durable, inbound
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Telemetry

_HEAD = struct.Struct("<IQd")  # of a block: its bytes, and the rest of `Spooled`
_NO_LINKS = np.zeros((0, 5), dtype=np.int32)


class Spooled(NamedTuple):
    """A block of the file."""

    block: Telemetry  # its rows alone
    events_bytes: int  # where the events of it and all before it end
    dt: float  # of a tick, s


class Spool:
    """Writes the file; what is written is with the system, and survives a kill."""

    def __init__(self, path: Path, dt: float) -> None:
        """A new file in the place of what is there."""
        self._file, self._dt = path.open("wb", buffering=0), dt

    def append(self, block: Telemetry, events_bytes: int) -> None:
        """Writes the rows of a block; if there is no room, nothing of them stays. Raises OSError."""
        rows = control.encode(msgspec.structs.replace(block, links=_NO_LINKS, events=(), checkpoint=b""))
        before = self._file.tell()
        try:
            durable.write(self._file, _HEAD.pack(len(rows), events_bytes, self._dt))
            durable.write(self._file, rows)
        except OSError:
            self._file.seek(before)
            self._file.truncate()
            raise

    def fileno(self) -> int:
        """The handle of the file."""
        return self._file.fileno()

    def close(self) -> None:
        """No more blocks."""
        self._file.close()


def spooled(path: Path) -> Iterator[Spooled]:
    """Everything before the cut a kill may have left. Raises OSError where there is no file."""
    with path.open("rb") as file:
        while True:
            try:
                size, events_bytes, dt = _HEAD.unpack(file.read(_HEAD.size))
                block = control.decode(file.read(min(size, control.MAX_BYTES + 1)))
                if not isinstance(block, Telemetry):
                    return
                inbound.check(block, None)
            except (struct.error, MessageRejected, OSError):
                return
            yield Spooled(block, events_bytes, dt)
