"""A node's side of the protocol, the same for agents and leader: join, answer every Sense with an Act, go home."""

import logging
import time
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from swarm import codec, keys
from swarm.bus import Bus, Delivery
from swarm.errors import BusError, MessageRejected
from swarm.messages import Act, Join, Ready, Refusal, Sense, Stop, Welcome

log = logging.getLogger("meanflock.node")

_READY_AGAIN_S = 0.2  # until the first Sense: what is put right after a declaration can get lost
_ASK_TIMEOUT_S = 2.0
_MAX_DROP_LINES = 100  # in the log; the counter goes on


class Node(Protocol):
    """Agent or leader."""

    def act(self, sense: Sense) -> Act:
        """Answers a Sense, or raises MessageRejected and has not changed."""


class Spoke:
    """One node on the bus."""

    def __init__(self, bus: Bus, run: str) -> None:
        self._bus, self._run = bus, run
        self._fingerprint = keys.fingerprint(run)
        self._node: Node | None = None
        self._last_tick = -1
        self._last_act = b""
        self.stopped: str | None = None  # why the world sent everyone home
        self.dropped: Counter[str] = Counter()

    def join(self, request: Join, make: Callable[[Welcome], Node], timeout_s: float) -> Welcome:
        """Asks until a world answers, builds the node, and listens.

        Raises:
            BusError: no world answered in time, or it refused.
        """
        question = keys.join(self._run, keys.asker(request.role, request.uav))
        end = time.monotonic() + timeout_s
        while (answer := self._bus.ask(question, codec.encode(request), _ASK_TIMEOUT_S)) is None:
            if time.monotonic() > end:
                raise BusError(f"no world of run {self._run!r} answered within {timeout_s:.0f} s")
        welcome = codec.decode(answer)
        if isinstance(welcome, Refusal):
            raise BusError(f"the world refused: {welcome.reason}")
        if not isinstance(welcome, Welcome) or welcome.run != self._fingerprint:
            raise BusError(f"the world of run {self._run!r} answered with {type(welcome).__name__}")
        self._node = make(welcome)
        self._speak = keys.act(self._run, welcome.node)
        self._bus.subscribe(keys.sense(self._run, welcome.node))
        self._bus.watch(keys.alive(self._run, "world", "world"))
        self._bus.announce(keys.alive(self._run, request.role, welcome.node))
        self._ready()
        return welcome

    def serve(self, cancelled: Callable[[], bool], abandoned: Callable[[], bool]) -> str:
        """Answers until the world says stop or is gone, and returns why.

        `cancelled` is asked after every delivery, `abandoned` only when there is nothing to do.
        """
        while self.stopped is None:
            if cancelled():
                return "interrupted"
            delivery = self._bus.receive(_READY_AGAIN_S)
            if delivery is not None:
                self.handle(delivery)
            elif abandoned():
                return "the launcher is gone"
            elif self._last_tick < 0:
                self._ready()
        return self.stopped

    def handle(self, delivery: Delivery) -> None:
        """One delivery. What does not fit is dropped, counted and logged; the node is as it was."""
        if delivery.kind == "gone":
            self.stopped = "the world is gone"
        elif delivery.kind == "message":
            try:
                self._answer(delivery.payload)
            except MessageRejected as error:
                self.dropped[error.reason] += 1
                if self.dropped.total() <= _MAX_DROP_LINES:
                    log.warning("dropped a message under %s: %s", delivery.key, error)

    def _answer(self, raw: bytes) -> None:
        message = codec.decode(raw)
        if isinstance(message, Stop) and message.run == self._fingerprint:
            self.stopped = message.reason
            return
        if not isinstance(message, Sense):
            raise MessageRejected("wrong-kind", f"{type(message).__name__}, expected Sense")
        if message.run != self._fingerprint:
            raise MessageRejected("wrong-run", f"run {message.run:#x}, this is {self._fingerprint:#x}")
        if message.tick < self._last_tick:
            raise MessageRejected("stale", f"tick {message.tick} after {self._last_tick}")
        if message.tick > self._last_tick:
            assert self._node is not None
            self._last_act = codec.encode(self._node.act(message))
            self._last_tick = message.tick
        # The same tick again: the world has not heard the answer. It gets the same one; nothing is learned twice.
        self._bus.put(self._speak, self._last_act)

    def _ready(self) -> None:
        self._bus.put(self._speak, codec.encode(Ready(self._fingerprint)))
