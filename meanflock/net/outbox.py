"""Outbox: the telemetry that waits until a ground station acknowledges it.

The world never waits for a ground station. It sends blocks while few are unacknowledged and keeps the rest, bounded; a
station that comes back gets what it missed.
"""

from collections import deque
from itertools import islice
from typing import Any

import msgspec

from meanflock.net import keys
from meanflock.net.bus import Bus
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Finished, Telemetry

MAX_WAITING_BYTES = 64 * 2**20
WINDOW_BLOCKS = 8


class Outbox:
    """Encoded blocks on their way to a ground station.

    dropped: blocks given up because too many waited.
    """

    def __init__(self, bus: Bus, run: str) -> None:
        self.dropped = 0
        self._bus = bus
        self._run = run
        self._fingerprint = keys.fingerprint(run)
        self._checkpoint = -1  # the last block that contains a checkpoint
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._bytes = 0
        self._sent_up_to = -1

    def add(self, block: Telemetry) -> None:
        """Keep a block until it is acknowledged; drop the oldest ones beyond the limit. Observers get it once."""
        if block.checkpoint:
            self._checkpoint = block.block
        self._add(msgspec.structs.replace(block, run=self._fingerprint))

    def finish(self, block: int, record: dict[str, Any]) -> None:
        """Add the summary under the number of a block, the last one."""
        self._finished = Finished(self._fingerprint, block, msgspec.json.encode(record))
        self._add(self._finished)

    def repeat_summary(self) -> None:
        """Send the summary again, ahead of all unacknowledged blocks."""
        self._bus.put(keys.telemetry(self._run), control.encode(self._finished))

    def acknowledge(self, block: int) -> None:
        """Forget every block up to this one: the station has them."""
        while self._waiting and self._waiting[0][0] <= block:
            self._bytes -= len(self._waiting.popleft()[1])

    def rewind(self) -> None:
        """Send all waiting blocks again: a station is new."""
        self._sent_up_to = -1

    def publish(self) -> None:
        """Send the blocks that may be sent now, in order; at most `WINDOW_BLOCKS` are unacknowledged."""
        ready = [(n, raw) for n, raw in islice(self._waiting, WINDOW_BLOCKS) if n > self._sent_up_to]
        if ready:
            self._sent_up_to = ready[-1][0]
        for _, raw in ready:
            self._bus.put(keys.telemetry(self._run), raw)

    @property
    def has_room(self) -> bool:
        """Returns whether the waiting blocks leave room for a part of a checkpoint without displacing telemetry."""
        return self._bytes < MAX_WAITING_BYTES // 4

    @property
    def holds_checkpoint(self) -> bool:
        """Returns whether the last checkpoint still waits. Another one would displace telemetry."""
        return bool(self._waiting) and self._waiting[0][0] <= self._checkpoint

    @property
    def waiting(self) -> int:
        """Number of unacknowledged blocks."""
        return len(self._waiting)

    def _add(self, block: Telemetry | Finished) -> None:
        raw = control.encode(block)
        self._waiting.append((block.block, raw))
        self._bytes += len(raw)
        while self._bytes > MAX_WAITING_BYTES:
            self._bytes -= len(self._waiting.popleft()[1])
            self.dropped += 1
        self._bus.tell(keys.observed(self._run), raw)
