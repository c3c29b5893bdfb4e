"""All rooms in one process and one thread: the same nodes, messages and codec as the swarm of processes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from meanflock.agent.node import Agent
from meanflock.agent.stepped import SteppedAgent, SteppedClient
from meanflock.groundstation.launch.station import Sink, Station
from meanflock.leader.node import Leader
from meanflock.swarm.net.bus import MemoryNetwork
from meanflock.swarm.net.client import Node, NodeClient
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.control import encode_record
from meanflock.swarm.wire.messages import Join, Welcome
from meanflock.worldsim.checkpoint import EVERY_TICKS, Resumption
from meanflock.worldsim.steering import Port
from meanflock.worldsim.world import World

# Of a block of telemetry. Here the recorder runs within a tick, and each call has a cost. A small swarm flies so many
# ticks in a few hundredths of a second.
_BLOCK_ROWS = 100
# UAV ticks between two checkpoints, for the same reason: a checkpoint may wait for the disk five times.
_CHECKPOINT_STATES, _CHECKPOINT_TICKS_AT_MOST = 25_000, 1000


Floats = NDArray[np.float64]
Observer = Callable[["Engine"], None]


class Engine:
    """One run in this process. Every node replies at once, so the world never waits."""

    def __init__(
        self,
        scenario: Scenario,
        run: str,
        *,
        uavs_per_node: int | None = None,
        sinks: Sequence[Sink] = (),
        realtime: float | None = None,
        steer: Port | None = None,
        resume: Resumption | None = None,
        leaders: int | None = None,
        memory: Mapping[str, NDArray[Any]] | None = None,
        stepped: bool = False,
    ) -> None:
        """`uavs_per_node`: None for all in one node. `sinks` get the telemetry; without any, nothing is encoded or
        stored. `steer`: where clients steer UAVs. `resume`: the checkpoint to continue from. `leaders`: one and its
        standbys; None: as many as the fault script needs. `memory`: arrays of N rows that replace the memory of `init`.
        `stepped`: one node of all UAVs, commanded through `outside`; its scenario flies the controller `stepped`.

        Raises:
            BadInput: the checkpoint does not fit the scenario.
        """
        self._run, self._memory = run, memory
        self._agents: list[Agent] = []
        self.outside: SteppedClient | None = None
        self.network = MemoryNetwork()
        hub = self.network.endpoint()
        self.world = World(
            scenario,
            hub,
            run,
            mode="in-process",
            realtime=realtime,
            steer=steer,
            resume=resume,
            checkpoint_every=_checkpoint_every(scenario, realtime) if sinks else 0,
            block_rows=_BLOCK_ROWS,
            telemetry=bool(sinks),
        )
        hub.handler = self.world.handle
        first_block = None if resume is None else resume.block + 1
        self.station = self._record(sinks, first_block, scenario.uavs) if sinks else None
        self._crew(scenario, uavs_per_node or scenario.uavs, leaders, stepped)
        self.world.gather(0.0)

    def _record(self, sinks: Sequence[Sink], first_block: int | None, uavs: int) -> Station:
        """Add a ground station."""
        bus = self.network.endpoint()
        station = Station(bus, self._run, sinks, first_block=first_block, uavs=uavs)
        bus.handler = station.handle
        return station

    def _crew(self, scenario: Scenario, rows: int, leaders: int | None, stepped: bool) -> None:
        """Add agents of at most so many rows, and the leaders."""
        if stepped:
            client = self.join(Join("agent", rows), SteppedAgent, SteppedClient)
            assert isinstance(client, SteppedClient)
            self.outside = client
        else:
            for _ in range(-(-scenario.uavs // rows)):
                self.join(Join("agent", rows), Agent)
        wanted = scenario.leaders(self.world.flight.tick)
        for _ in range(wanted if leaders is None else leaders):
            self.join(Join("leader", 0), Leader)

    def fly(self) -> Iterator[int]:
        """See `World.fly`."""
        return self.world.fly()

    def complete(self, observe: Observer | None = None) -> dict[str, Any]:
        """Fly the whole flight; returns its summary. `observe` is called at take-off and after every tick. It may read
        `world.flight`, `world.air.meter`, `world.diagnostics` and `models`, and must not change them.
        """
        if observe is not None:
            observe(self)
        for _ in self.fly():
            if observe is not None:
                observe(self)
        return self.world.finish()

    @property
    def models(self) -> Floats:
        """Learned weights of every UAV, `(N, W)`; the last ones of a lost UAV."""
        scenario = self.world.flight.scenario
        models = np.zeros((scenario.uavs, scenario.declared.weights))
        for agent in self._agents:
            models[agent.uavs] = agent.models
        return models

    def join(
        self, request: Join, make: Callable[[Welcome], Node], client_type: type[NodeClient] = NodeClient
    ) -> NodeClient:
        """Add another node to this process."""

        def build(welcome: Welcome) -> Node:
            if self._memory is not None and welcome.tick == 0:
                rows = {name: array[list(welcome.uavs)] for name, array in self._memory.items()}
                welcome = structs.replace(welcome, memory=encode_record(rows))
            node = make(welcome)
            if isinstance(node, Agent):
                self._agents.append(node)
            return node

        bus = self.network.endpoint()
        client = client_type(bus, self._run)
        bus.handler = client.handle
        client.join(request, build, timeout_s=0.0)
        return client


def _checkpoint_every(scenario: Scenario, realtime: float | None) -> int:
    """Ticks between checkpoints: a multiple of that of a swarm of processes, or the same in real time."""
    if realtime is not None:
        return EVERY_TICKS
    ticks = min(_CHECKPOINT_TICKS_AT_MOST, _CHECKPOINT_STATES // scenario.uavs)
    return max(EVERY_TICKS, ticks // EVERY_TICKS * EVERY_TICKS)
