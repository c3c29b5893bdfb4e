"""The ground station on the bus: takes the telemetry in order, hands it to the sinks, tells the world it is safe."""

import json
import logging
from collections.abc import Sequence
from typing import Any, Protocol

from swarm import codec, keys
from swarm.bus import Bus, Delivery
from swarm.errors import MessageRejected
from swarm.messages import Finished, Received, Telemetry

log = logging.getLogger("meanflock.station")


class Sink(Protocol):
    """Something that keeps or shows telemetry."""

    def write(self, block: Telemetry) -> None:
        """Takes the next block; blocks come in order, each once."""


class Station:
    """One recording listener."""

    def __init__(
        self, bus: Bus, run: str, sinks: Sequence[Sink], name: str = "station", first_block: int | None = None
    ) -> None:
        """`first_block`: the first one the sinks do not have yet; None for whatever comes first."""
        self._bus, self._run, self._sinks = bus, run, sinks
        self._fingerprint = keys.fingerprint(run)
        self._next_block = first_block
        self.summary: dict[str, Any] | None = None
        self.missed_blocks = 0
        bus.subscribe(keys.telemetry(run))
        bus.announce(keys.alive(run, "station", name))

    def handle(self, delivery: Delivery) -> None:
        """One delivery; what is not telemetry of this run is logged and dropped."""
        if delivery.kind != "message":
            return
        try:
            message = codec.decode(delivery.payload)
            if isinstance(message, Telemetry) and message.run == self._fingerprint:
                self._take(message)
            elif isinstance(message, Finished) and message.run == self._fingerprint:
                self.summary = json.loads(message.summary)
                self._acknowledge(message.block)
            else:
                raise MessageRejected("wrong-kind", type(message).__name__)
        except (MessageRejected, json.JSONDecodeError) as error:
            reason = error.reason if isinstance(error, MessageRejected) else "malformed"
            log.warning("dropped a message under %s: %s", delivery.key, error, extra={"reason": reason})

    def _take(self, block: Telemetry) -> None:
        expected = block.block if self._next_block is None else self._next_block
        if block.block >= expected:  # an older one is a repetition
            self.missed_blocks += block.block - expected
            for sink in self._sinks:
                sink.write(block)
            self._next_block = block.block + 1
        self._acknowledge(block.block)

    def _acknowledge(self, block: int) -> None:
        self._bus.put(keys.received(self._run), codec.encode(Received(self._fingerprint, block)))
