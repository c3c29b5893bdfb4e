"""Ground station on the bus: receives telemetry in order, passes it to the sinks, and acknowledges it."""

import logging
import os
from collections import Counter
from collections.abc import Sequence
from typing import Any

from meanflock.net import keys
from meanflock.net.access import STATION
from meanflock.net.bus import Bus, Delivery
from meanflock.results import inbound
from meanflock.swarm import logs
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.events import GlobalDraw, NoCheckpoint
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Acknowledgement, Finished, Join, Telemetry
from meanflock.worldsim.reporting import BlockSink

log = logging.getLogger("meanflock.station")

MAX_DROP_LINES = 100  # in the log; the counter counts all
_ASK_S = 2.0  # at most, for what is missing


class StoredTelemetry:
    """Sink that stores the telemetry of a flight in memory."""

    def __init__(self) -> None:
        self.blocks: list[Telemetry] = []

    def write(self, block: Telemetry) -> None:
        """Takes the next block."""
        self.blocks.append(block)


class WarningNotes:
    """Sink that prints what a user must know of the plug-ins while the flight goes on."""

    def write(self, block: Telemetry) -> None:
        """Prints such events of the next block."""
        for event in block.events:
            if isinstance(event, GlobalDraw | NoCheckpoint):
                logs.note(event.text, logging.WARNING)


class RecordingStation:
    """One recording listener."""

    def __init__(
        self,
        bus: Bus,
        run: str,
        sinks: Sequence[BlockSink],
        first_block: int | None = None,
        uavs: int | None = None,
        nodes: int | None = None,
        dimensions: int | None = None,
    ) -> None:
        """`first_block`: the first block that the sinks need; None: the first that arrives. `uavs`: number of UAVs;
        None: as in the telemetry. `nodes`: of them and of the stations of the radio; None: as many. `dimensions`: of
        the flight; None: as in the telemetry.
        """
        self._bus = bus
        self._run = run
        self._sinks = sinks
        self._fingerprint = keys.fingerprint(run)
        self._next_block, self._uavs, self._nodes, self._dimensions = first_block, uavs, nodes, dimensions
        self._asked_at = -1  # the block before which others were missing when the world was asked
        self.summary: dict[str, Any] | None = None
        self.dropped: Counter[str] = Counter()
        bus.subscribe(keys.telemetry(run))
        # The world notices only the first of equal tokens. Without this, a station would get nothing if the world has
        # not yet noticed the loss of the station that it replaces.
        bus.announce(keys.alive(run, STATION, f"{STATION}.{os.urandom(4).hex()}"))

    def handle(self, delivery: Delivery) -> None:
        """Handle one delivery. Anything but telemetry of this run is dropped, counted and logged."""
        if delivery.kind != "message":
            return
        try:
            message = control.decode(delivery.payload)
            if isinstance(message, Telemetry) and message.run == self._fingerprint:
                self._take(message)
            elif isinstance(message, Finished) and message.run == self._fingerprint:
                record = inbound.summary(message)
                if self._follows(message.block):
                    self.summary = record
                    self._acknowledge(message.block)
            else:
                raise MessageRejected("wrong-kind", type(message).__name__)
        except MessageRejected as error:
            self.dropped[error.reason] += 1
            if self.dropped.total() <= MAX_DROP_LINES:
                log.warning("dropped a message under %s: %s", delivery.key, error, extra={"reason": error.reason})

    def _take(self, block: Telemetry) -> None:
        inbound.check(block, self._uavs, self._nodes, self._dimensions)
        if not self._follows(block.block):
            return
        expected = block.block if self._next_block is None else self._next_block
        if block.block >= expected:  # an older one is a repetition
            if missing := block.block - expected:
                log.warning("%d blocks of telemetry before tick %d will never come", missing, block.first_tick)
            for sink in self._sinks:
                sink.write(block)
            self._next_block = block.block + 1
        self._acknowledge(block.block)

    def _follows(self, block: int) -> bool:
        """Returns whether no earlier block is missing, or all missing ones are lost.

        The world still has blocks that were lost with a session, so the station first asks it to send all waiting
        blocks again. A block that does not come then was dropped by the world.
        """
        if self._next_block is None or block <= max(self._next_block, self._asked_at):
            self._asked_at = -1
            return True
        join = control.encode(Join(STATION, 0))
        if self._asked_at < 0 and self._bus.ask(keys.join(self._run, STATION), join, _ASK_S) is not None:
            self._asked_at = block
        return False

    def _acknowledge(self, block: int) -> None:
        self._bus.put(keys.received(self._run), control.encode(Acknowledgement(self._fingerprint, block)))
