"""Observer of a live flight: it reads the telemetry, and neither acknowledges nor writes anything."""

import logging
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from meanflock.net import keys
from meanflock.net.access import OBSERVER, WORLD, Identity
from meanflock.net.bus import Bus
from meanflock.net.client import connected
from meanflock.net.session import ZenohBus
from meanflock.results import inbound
from meanflock.results.flown import FlownKeys
from meanflock.swarm.errors import BusError, MessageRejected, RunFailed
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Finished, Join, Telemetry, Welcome
from meanflock.worldsim.reporting import BlockSink

log = logging.getLogger("meanflock.observer")

_ASK_S = 2.0
_STEP_S = 0.2
_LAST_S = 2.0  # messages that are on their way when the world is gone


def open_bus(endpoint: str, wait_s: float, tls: Path | None) -> Bus:
    """Open a session with the world at `endpoint`; `tls`: folder of certificates.

    Raises:
        BadInput: a certificate cannot be used. BusError: there is no world in time.
    """
    identity = Identity(tls, OBSERVER) if tls is not None else None
    end = time.monotonic() + wait_s
    return connected(lambda left_s: ZenohBus.client(endpoint, left_s, identity), end, lambda: False)


class Observer:
    """One listener to the flight of a bus; the world does not know it.

    run: name of the run. scenario: keys of what is flown. summary: of the flight, when it is over.
    """

    def __init__(self, bus: Bus, wait_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Find the flight.

        Raises:
            BusError: no world answers in time.
        """
        self._bus, self._clock = bus, clock
        self.summary: dict[str, Any] | None = None
        bus.watch(keys.alive("*", WORLD, WORLD))
        end = clock() + wait_s
        while (delivery := bus.receive(_STEP_S)) is None or delivery.kind != "alive":
            if clock() > end:
                raise BusError(f"no flight within {wait_s:g} s: is this the endpoint of its world?")
        self.run = delivery.key.split("/")[1]
        self._fingerprint = keys.fingerprint(self.run)
        bus.subscribe(keys.observed(self.run))
        request = control.encode(Join(OBSERVER, 0))
        answer = bus.ask(keys.join(self.run, OBSERVER), request, max(_ASK_S, end - clock()))
        welcome = None if answer is None else control.decode(answer)
        if not isinstance(welcome, Welcome) or welcome.run != self._fingerprint:
            raise BusError(f"the world of run {self.run!r} did not say what is flown")
        self.scenario = msgspec.json.decode(welcome.scenario, type=FlownKeys)

    def listen(self, sink: BlockSink) -> dict[str, Any]:
        """Pass on all telemetry from now on; returns the summary at the end of the flight.

        Raises:
            RunFailed: the world is gone without a summary.
        """
        expected: int | None = None
        end, flown = math.inf, self.scenario
        while self.summary is None:
            delivery = self._bus.receive(_STEP_S)
            if self._clock() > end:
                raise RunFailed("the world is gone, without a summary of the flight")
            if delivery is None:
                continue
            if delivery.kind == "gone":  # it may overtake the last messages
                end = self._clock() + _LAST_S
            if delivery.kind != "message":
                continue
            try:
                message = control.decode(delivery.payload)
                if isinstance(message, Telemetry) and message.run == self._fingerprint:
                    block = inbound.check(message, flown.uavs, flown.uavs + len(flown.stations), flown.space.dimensions)
                    if expected is not None and block.block > expected:
                        log.warning("%d blocks before tick %d did not arrive", block.block - expected, block.first_tick)
                    expected = block.block + 1
                    sink.write(block)
                elif isinstance(message, Finished) and message.run == self._fingerprint:
                    self.summary = inbound.summary(message)
                else:
                    raise MessageRejected("wrong-kind", type(message).__name__)
            except MessageRejected as error:
                log.warning("dropped a message under %s: %s", delivery.key, error)
        return self.summary
