"""A flight in real time whose nodes reply as late as they are told to."""

from collections.abc import Callable, Sequence

import numpy as np

from meanflock.agent.node import Agent
from meanflock.leader.node import Leader
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery, MemoryBus, MemoryNetwork, Offer
from meanflock.swarm.net.client import NodeClient
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Join
from meanflock.worldsim.world import World

RUN = "late"
TICK_S = 0.05  # dt = 0.1 s, twice as fast as the wall clock
PROMPT_S = 0.01


class SlowBus(MemoryBus):
    """The world's bus on a clock that only passes while somebody waits: every answer has its delay."""

    def __init__(self, network: MemoryNetwork) -> None:
        super().__init__(network, None)
        network.endpoints.append(self)
        self.now = 0.0
        self.delay_s: Callable[[str], float] = lambda node: PROMPT_S
        self.world: World
        self._coming: list[tuple[float, int, Delivery]] = []

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        super().subscribe(key)  # nothing is here at once

    def _deliver(self, delivery: Delivery) -> None:
        if delivery.kind != "message":
            self.world.handle(delivery)
            return
        due = self.now + self.delay_s(keys.node_of(delivery.key))
        self._coming.append((due, len(self._coming), delivery))

    def receive(self, timeout_s: float) -> Delivery | None:
        self._coming.sort(key=lambda entry: entry[:2])
        if self._coming and self._coming[0][0] <= self.now + timeout_s:
            due, _, delivery = self._coming.pop(0)
            self.now = max(self.now, due)
            return delivery
        self.now += timeout_s
        return None


class Flight:
    """Two UAVs or so, each on a node of its own, 20 ticks or so in real time, or in lockstep."""

    def __init__(
        self, realtime: float | None = 2.0, settings: Sequence[str] = (), rows: Sequence[int] = (1, 1)
    ) -> None:
        """`rows`: UAVs of each agent."""
        self._network = MemoryNetwork()
        self.bus = SlowBus(self._network)
        flown = load(None, [f"uavs={sum(rows)}", "method=mfg", "duration=2", 'stop="duration"', *settings])
        self.world = self.bus.world = World(flown, self.bus, RUN, realtime=realtime, clock=lambda: self.bus.now)
        for count in rows:
            self._join(Join("agent", count), Agent)
        if flown.declared.is_federated:
            self._join(Join("leader", 0), Leader)
        self.world.gather(10.0)
        self.commands: list[np.ndarray] = []

    def _join(self, request: Join, make: Callable[..., Agent | Leader]) -> None:
        endpoint = self._network.endpoint()
        client = NodeClient(endpoint, RUN)
        endpoint.handler = client.handle
        client.join(request, make, timeout_s=1.0)

    def fly(self, before: Callable[[int], None] = lambda tick: None) -> dict:
        before(0)
        for tick in self.world.fly():
            self.commands.append(self.world._commands.accelerations.copy())
            before(tick)
        return self.world.finish(lambda: 0.0)
