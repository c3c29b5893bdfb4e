"""What the swarm asks of a bus, and the bus of one process.

A `Bus` is one participant's access to keys. Everything that comes in — messages, questions, liveliness — is a
`Delivery` in one queue, so a node is one loop with one place to wait. `MemoryBus` passes the same encoded bytes
as the network does; an endpoint with a handler is called at once, which lets one thread run a whole swarm.
"""

import queue
from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import msgspec

Handler = Callable[["Delivery"], None]
Offer = Callable[[str, bytes], bool]  # key and payload of a message; whether it is taken


class Delivery(msgspec.Struct, frozen=True):
    """Something that reached this participant.

    kind: "message" (someone put `payload` under `key`), "question" (someone waits for `reply`),
        "alive" or "gone" (a liveliness token appeared or vanished under `key`),
        "oversized" (a message or question of so many bytes, `size`, that they were not taken in; `largest` may be).
    """

    kind: Literal["message", "question", "alive", "gone", "oversized"]
    key: str
    payload: bytes = b""
    reply: Callable[[bytes], None] | None = None
    size: int = 0
    largest: int = 0


class Quota(NamedTuple):
    """What one sender may have waiting at a bus that limits it (`ZenohBus.router`)."""

    owner: str  # the sender: what waits under all its keys is counted together
    largest: int  # bytes a message may have


Quotas = Callable[[str], Quota]  # of a key; asked in any thread


class Bus(Protocol):
    """One participant's access. Messages of one publisher under one key arrive in order; none before `subscribe`."""

    def put(self, key: str, payload: bytes) -> None:
        """Sends `payload` to every subscriber of `key`."""

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        """From now on, messages under `key` (`*` stands for one part) are received.

        `offer` is asked first, in whatever thread brings the message: what it takes is not received. It must not wait.
        """

    def answer(self, key: str) -> None:
        """From now on, questions under `key` are received."""

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        """The first answer to `payload`, or None where none came in time."""

    def announce(self, key: str) -> None:
        """Declares a liveliness token; it vanishes with this participant."""

    def watch(self, key: str) -> None:
        """From now on, tokens that appear or vanish under `key` are received; those already there first."""

    def receive(self, timeout_s: float) -> Delivery | None:
        """The next delivery, or None where none came in time."""

    def close(self) -> None:
        """Leaves: tokens vanish, nothing is received any more. Closing twice is harmless."""


def matches(pattern: str, key: str) -> bool:
    """Whether `key` is under `pattern`, where a part `*` stands for any one part."""
    wanted, parts = pattern.split("/"), key.split("/")
    return len(wanted) == len(parts) and all(want in ("*", part) for want, part in zip(wanted, parts, strict=True))


class MemoryNetwork:
    """The wire between the endpoints of one process."""

    def __init__(self) -> None:
        self.endpoints: list[MemoryBus] = []

    def endpoint(self, handler: Handler | None = None) -> "MemoryBus":
        """A new participant; with a handler, deliveries are handled at once in the sender's thread."""
        bus = MemoryBus(self, handler)
        self.endpoints.append(bus)
        return bus


class MemoryBus:
    """A `Bus` within one process."""

    def __init__(self, network: MemoryNetwork, handler: Handler | None) -> None:
        self.handler = handler
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
