"""Swarms in one process that lose nodes."""

import itertools
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

import pytest

from meanflock.agent.node import Agent
from meanflock.kernels.wire import SENSE
from meanflock.leader.node import Leader
from meanflock.net import keys
from meanflock.net.bus import MemoryBus
from meanflock.net.client import NodeClient
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Act, Frames, Join
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.memory_swarm import MemorySwarm
from tests.swarm.examples import read, written
from tests.telemetry import Record

RUN = "faults"


@pytest.fixture(scope="module", autouse=True)
def frequent_checkpoints() -> Iterator[None]:
    """Checkpoints as frequent as in a swarm of processes, so that short flights have some."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("meanflock.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
        yield


def scenario(*settings: str, method: str = "mfgfl-h") -> Scenario:
    fixed = ["uavs=6", "seed=3", "duration=12", 'stop="duration"', "federation.period=20"]
    return load(None, [*fixed, *settings], method=method)


class Lab:
    """A swarm whose nodes can die and be started again between two ticks."""

    def __init__(self, flown: Scenario, **options: Any) -> None:
        self.record = Record()
        self.now: Callable[[], float] = time.monotonic
        self.engine = MemorySwarm(flown, RUN, sinks=[self.record], clock=lambda: self.now(), **options)
        self.world = self.engine.world

    def fly(self, at: dict[int, Callable[[], Any]] | None = None) -> dict[str, Any]:
        """To the end; what is in `at` happens before the tick of that number."""
        for tick in self.engine.fly():
            if at and tick in at:
                at[tick]()
        return self.engine.finish()

    def bus_of(self, name: str) -> MemoryBus:
        key = keys.sense(RUN, name)
        (bus,) = (bus for bus in self.engine.network.endpoints if key in bus._subscriptions)
        return bus

    def client_of(self, name: str) -> NodeClient:
        return self.bus_of(name).handler.__self__

    def listen(self, hear: Callable[[int, Frames], Any]) -> None:
        """From now on calls `hear` with the tick and each batch of frames that is transmitted."""
        send = self.world.air.send

        def tell(tick: int, frames: list[Frames], *rest: Any) -> Any:
            for batch in frames:
                hear(tick, batch)
            return send(tick, frames, *rest)

        self.world.air.send = tell

    def kill(self, name: str) -> None:
        """The node is gone, and its token with it."""
        self.bus_of(name).close()

    def kill_when_asked(self, name: str, replies: bool = False) -> None:
        """The node is killed at its next request, before or after it replies."""
        bus = self.bus_of(name)
        ((key, reply),) = bus._subscriptions.items()

        def die(key: str, raw: bytes) -> bool:
            if raw[1] != SENSE:
                return reply(key, raw)
            if replies:
                reply(key, raw)
            bus.close()
            return True

        bus.subscribe(key, die)

    def freeze(self, name: str) -> None:
        """The node takes nothing more and keeps its token; from now on a barrier's patience takes no time."""
        bus = self.bus_of(name)
        for key in bus._subscriptions:
            bus.subscribe(key)
        bus.handler = lambda delivery: None
        looks = itertools.count(int(time.monotonic()) + 1)
        self.now = lambda: float(next(looks))
        self.engine.hub.receive = lambda timeout_s: None

    def agent(self, rows: int = 1) -> NodeClient:
        return self.engine.join(Join("agent", rows), Agent)

    def leader(self) -> NodeClient:
        return self.engine.join(Join("leader", 0), Leader)


@cache
def _honest(encoded: bytes) -> dict[str, Any]:
    return Lab(scenarios.decode(encoded)).fly()


def honest(flown: Scenario, field: str = "trajectory_sha256") -> Any:
    """A field of the summary of a flight in which nobody lies and nobody is hurt."""
    return _honest(scenarios.encode(flown))[field]


Say = Callable[[Act], Iterable[Act | bytes]]


def saying(flown: Scenario, node: str, say: Say) -> Lab:
    """A flight in which a node sends `say(act)` in place of each act."""
    lab = Lab(flown, uavs_per_node=1)
    client = lab.client_of(node)
    put = client._bus.put

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        for message in say(act) if isinstance(act, Act) else [raw]:
            put(key, message if isinstance(message, bytes) else written(message))

    client._bus.put = speak
    return lab
