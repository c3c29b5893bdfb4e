"""The ground station on the bus: takes the telemetry in order, hands it to the sinks, tells the world it is safe."""

import logging
import os
from collections import Counter
from collections.abc import Sequence
from typing import Any, Protocol

from meanflock.groundstation import inbound
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus, Delivery
from meanflock.swarm.net.identity import STATION
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Finished, Received, Telemetry

log = logging.getLogger("meanflock.station")

MAX_DROP_LINES = 100  # in the log; the counter goes on


class Sink(Protocol):
    """Something that keeps or shows telemetry."""

    def write(self, block: Telemetry) -> None:
        """Takes the next block; blocks come in order, each once."""


class Kept:
    """A sink that keeps the telemetry of a flight in memory."""

    def __init__(self) -> None:
        self.blocks: list[Telemetry] = []

    def write(self, block: Telemetry) -> None:
        """Takes the next block."""
        self.blocks.append(block)


class Station:
    """One recording listener."""

    def __init__(
        self,
        bus: Bus,
        run: str,
        sinks: Sequence[Sink],
        first_block: int | None = None,
        uavs: int | None = None,
    ) -> None:
        """`first_block`: the first one the sinks do not have yet; None for whatever comes first. `uavs`: of the swarm
        that is flown; None for what the telemetry says.
        """
        self._bus, self._run, self._sinks = bus, run, sinks
        self._fingerprint = keys.fingerprint(run)
        self._next_block, self._uavs = first_block, uavs
        self.summary: dict[str, Any] | None = None
        self.dropped: Counter[str] = Counter()
        bus.subscribe(keys.telemetry(run))
        # Of equal tokens the world is told of the first alone: it would send nothing to who takes the place of one that
        # it does not miss yet.
        bus.announce(keys.alive(run, STATION, f"{STATION}.{os.urandom(4).hex()}"))

    def handle(self, delivery: Delivery) -> None:
        """One delivery; what is not telemetry of this run is dropped, counted and logged."""
        if delivery.kind != "message":
            return
        try:
            message = control.decode(delivery.payload)
            if isinstance(message, Telemetry) and message.run == self._fingerprint:
                self._take(message)
            elif isinstance(message, Finished) and message.run == self._fingerprint:
                self.summary = inbound.summary(message)
                self._acknowledge(message.block)
            else:
                raise MessageRejected("wrong-kind", type(message).__name__)
        except MessageRejected as error:
            self.dropped[error.reason] += 1
            if self.dropped.total() <= MAX_DROP_LINES:
                log.warning("dropped a message under %s: %s", delivery.key, error, extra={"reason": error.reason})

    def _take(self, block: Telemetry) -> None:
        inbound.check(block, self._uavs)
        expected = block.block if self._next_block is None else self._next_block
        if block.block >= expected:  # an older one is a repetition
            if missing := block.block - expected:
                log.warning("%d blocks of telemetry before tick %d will never come", missing, block.first_tick)
            for sink in self._sinks:
                sink.write(block)
            self._next_block = block.block + 1
        self._acknowledge(block.block)

    def _acknowledge(self, block: int) -> None:
        self._bus.put(keys.received(self._run), control.encode(Received(self._fingerprint, block)))
