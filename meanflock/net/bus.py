"""The interface of a bus, and the bus within one process.

A `Bus` is one participant's access to keys. All that comes in (messages, questions, liveliness) is a `Delivery` in one
queue, so a node is one loop that waits in one place. `MemoryBus` passes the same encoded bytes as the network does; it
calls a participant with a handler at once, so one thread can run a whole swarm.
"""

import queue
from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import msgspec

Handler = Callable[["Delivery"], None]
Offer = Callable[[str, bytes], bool]  # key and payload of a message; returns whether the message is accepted


class Delivery(msgspec.Struct, frozen=True):
    """Message or event that reached this participant.

    kind: "message" (a participant put `payload` under `key`), "question" (a participant waits for `reply`),
        "alive" or "gone" (a liveliness token appeared or vanished under `key`),
        "oversized" (a message or question of `size` bytes was dropped, because it is longer than `largest`).
    """

    kind: Literal["message", "question", "alive", "gone", "oversized"]
    key: str
    payload: bytes = b""
    reply: Callable[[bytes], None] | None = None
    size: int = 0
    largest: int = 0


class Quota(NamedTuple):
    """Sender of the messages under a key, and the limit of their length (`ZenohBus.router`)."""

    owner: str  # the sender: messages under all its keys are counted together
    largest: int  # bytes a message may have


Quotas = Callable[[str], Quota]  # quota of a key; called in any thread


class Bus(Protocol):
    """Access of one participant to the bus. Messages of one publisher under one key arrive in order."""

    def put(self, key: str, payload: bytes) -> None:
        """Sends `payload` to every subscriber of `key`."""

    def tell(self, key: str, payload: bytes) -> None:
        """Sends `payload` to those subscribers of `key` that can take it at once; never waits for one."""

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        """From now on, messages under `key` (`*` stands for one part) are received.

        `offer` is called first, in the thread that brings the message: a message that it accepts is not received. It
        must not wait.
        """

    def answer(self, key: str) -> None:
        """From now on, questions under `key` are received."""

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        """The first answer to `payload`, or None if none came in time."""

    def announce(self, key: str) -> None:
        """Declares a liveliness token; it vanishes with this participant."""

    def watch(self, key: str) -> None:
        """From now on, tokens that appear or vanish under `key` are received; existing ones first."""

    def receive(self, timeout_s: float) -> Delivery | None:
        """The next delivery, or None if none came in time."""

    def close(self) -> None:
        """Leaves: tokens vanish, and nothing more is received. A second call is harmless."""


def matches(pattern: str, key: str) -> bool:
    """Returns whether `key` matches `pattern`, in which a part `*` stands for any one part."""
    wanted, parts = pattern.split("/"), key.split("/")
    return len(wanted) == len(parts) and all(want in ("*", part) for want, part in zip(wanted, parts, strict=True))


class MemoryNetwork:
    """The wire between the endpoints of one process."""

    def __init__(self) -> None:
        self.endpoints: list[MemoryBus] = []

    def endpoint(self) -> "MemoryBus":
        """A new participant."""
        bus = MemoryBus(self)
        self.endpoints.append(bus)
        return bus


class MemoryBus:
    """A `Bus` within one process.

    handler: called with each delivery at once, in the sender's thread; None: deliveries wait for `receive`.
    """

    def __init__(self, network: MemoryNetwork) -> None:
        self.handler: Handler | None = None
        self._network = network
        self._queue: queue.SimpleQueue[Delivery] = queue.SimpleQueue()
        self._subscriptions: dict[str, Offer | None] = {}
        self._questions: list[str] = []
        self._watched: list[str] = []
        self._tokens: list[str] = []
        self._routes: dict[str, list[tuple[MemoryBus, Offer | None]]] = {}

    def put(self, key: str, payload: bytes) -> None:
        for bus, offer in self._route(key):
            if offer is None or not offer(key, payload):
                bus._deliver(Delivery("message", key, payload))

    def tell(self, key: str, payload: bytes) -> None:
        self.put(key, payload)

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        self._subscriptions[key] = offer
        for bus in self._network.endpoints:
            bus._routes.clear()

    def answer(self, key: str) -> None:
        self._questions.append(key)

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        for bus in self._network.endpoints:
            if any(matches(pattern, key) for pattern in bus._questions):
                bus._deliver(Delivery("question", key, payload, answers.put))
        try:
            return answers.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def announce(self, key: str) -> None:
        self._tokens.append(key)
        self._notify("alive", key)

    def watch(self, key: str) -> None:
        self._watched.append(key)
        for bus in self._network.endpoints:
            for token in bus._tokens:
                if matches(key, token):
                    self._deliver(Delivery("alive", token))

    def receive(self, timeout_s: float) -> Delivery | None:
        try:
            return self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def close(self) -> None:
        if self not in self._network.endpoints:
            return
        self._network.endpoints.remove(self)
        tokens, self._tokens = self._tokens, []
        for token in tokens:
            self._notify("gone", token)
        for bus in self._network.endpoints:
            bus._routes.clear()

    def _route(self, key: str) -> list[tuple["MemoryBus", Offer | None]]:
        if key not in self._routes:
            self._routes[key] = [
                (bus, offer)
                for bus in self._network.endpoints
                for pattern, offer in bus._subscriptions.items()
                if matches(pattern, key)
            ]
        return self._routes[key]

    def _notify(self, kind: Literal["alive", "gone"], token: str) -> None:
        for bus in self._network.endpoints:
            if any(matches(pattern, token) for pattern in bus._watched):
                bus._deliver(Delivery(kind, token))

    def _deliver(self, delivery: Delivery) -> None:
        if self.handler is not None:
            self.handler(delivery)
        else:
            self._queue.put(delivery)
