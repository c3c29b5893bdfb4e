"""The floor of a networked tick: a lockstep of raw bytes over the same Zenoh session settings, and nothing else.

The benchmark process is router and world; every client is a process that answers each message with the requested number
of bytes. No codec, no learning, no physics. `python -m benchmarks.lockstep_floor` is such a client, or many that are
forked as agents are: so they share memory and caches.
"""

import argparse
import struct
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from meanflock.launch.prefork import fork
from meanflock.net import keys
from meanflock.net.process import orphaned
from meanflock.net.session import ZenohBus

if TYPE_CHECKING:
    from benchmarks.processes import Children

_HEAD = struct.Struct("<II")  # tick, size of the answer wanted
_HELLO = 0xFFFFFFFF
_AGAIN_S = 0.2
_GATHER_S = 60.0


class FloorWorld:
    """The world's side. Names are those of the swarm's nodes, so keys are as long."""

    def __init__(self, endpoint: str, run: str, names: Sequence[str]) -> None:
        self._run, self._names = run, names
        self._tick = self._left = 0
        self._gate = threading.Lock()
        self._bus = ZenohBus.router(endpoint)
        self._bus.subscribe(keys.act(run, "*"), self._overhear)
        self._sense = {name: keys.sense(run, name) for name in names}

    def gather(self) -> None:
        """Waits for every client.

        Raises:
            TimeoutError: one did not come.
        """
        end = time.monotonic() + _GATHER_S
        missing = set(self._names)
        while missing:
            delivery = self._bus.receive(0.1)
            if delivery is not None:
                missing.discard(keys.node_of(delivery.key))
            if time.monotonic() > end:
                raise TimeoutError(f"no word from {len(missing)} floor clients")

    def tick(self, asked: Mapping[str, tuple[int, int]]) -> None:
        """Puts `bytes out` to each name of `asked` and waits until each has answered with `bytes in`."""
        with self._gate:
            self._tick, self._left = self._tick + 1, len(asked)
        for name, (out, back) in asked.items():
            self._bus.put(self._sense[name], _HEAD.pack(self._tick, back).ljust(out, b"\0"))
        end = time.monotonic() + _GATHER_S
        while self._left:
            delivery = self._bus.receive(1.0)
            if delivery is None:
                if time.monotonic() > end:
                    raise TimeoutError("a floor client does not answer")
                continue
            with self._gate:
                self._left -= _HEAD.unpack_from(delivery.payload)[0] == self._tick

    def _overhear(self, _key: str, answer: bytes) -> bool:
        """Count answers in the thread that brings them, as the world does; the waiting thread gets the last one."""
        with self._gate:
            if self._left < 2 or _HEAD.unpack_from(answer)[0] != self._tick:
                return False
            self._left -= 1
            return True

    def close(self) -> None:
        """End the clients."""
        for key in self._sense.values():
            self._bus.put(key, b"")
        time.sleep(0.05)  # the last messages are lost if the router closes at once
        self._bus.close()


@contextmanager
def floor_of(children: "Children", names: Sequence[str]) -> Iterator[FloorWorld]:
    """Context with the world of such clients, which end with it."""
    world = FloorWorld(children.endpoint, children.run, names)
    try:
        yield world
    finally:
        world.close()
        children.wait(2.0)


def main() -> None:
    """A client: announces itself until the first request, then answers."""
    options = argparse.ArgumentParser()
    options.add_argument("--endpoint", required=True)
    options.add_argument("--run", required=True)
    options.add_argument("--node", default="agent")
    options.add_argument("--count", type=int, default=0, help="clients to become, each with its number behind the name")
    options.add_argument("--imports", action="store_true", help="load what an agent loads, too")
    given = options.parse_args()
    if given.imports:
        import msgspec  # noqa: F401
        import numpy as np  # noqa: F401
    node = f"{given.node}-{fork(given.count)}" if given.count else given.node
    bus = ZenohBus.client(given.endpoint)
    try:
        speak = keys.act(given.run, node)
        asked = False

        def answer(_key: str, question: bytes) -> bool:
            nonlocal asked
            if asked := bool(question):
                bus.put(speak, question[: _HEAD.size].ljust(_HEAD.unpack_from(question)[1], b"\0"))
            return asked

        bus.subscribe(keys.sense(given.run, node), answer)
        hello = _HEAD.pack(_HELLO, 0)
        bus.put(speak, hello)
        while bus.receive(_AGAIN_S) is None and not orphaned():
            if not asked:
                bus.put(speak, hello)
    finally:
        bus.close()


if __name__ == "__main__":
    main()
