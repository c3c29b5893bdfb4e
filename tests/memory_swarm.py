"""A swarm of nodes on a bus within this process: messages, codec and protocol are those of processes."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from meanflock.agent.node import Agent
from meanflock.federation.plan import plan_of
from meanflock.launch import engine
from meanflock.launch.station import RecordingStation
from meanflock.leader.node import Leader
from meanflock.net.bus import Bus, MemoryNetwork
from meanflock.net.client import Node, NodeClient
from meanflock.net.networked import NetworkedRun
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Join, Welcome
from meanflock.worldsim.checkpoint import Resumption
from meanflock.worldsim.reporting import BlockSink


class MemorySwarm(NetworkedRun):
    """A run on the bus of a network in memory, with its nodes. A node replies at once, unless its bus is another."""

    def __init__(
        self,
        scenario: Scenario,
        run: str,
        *,
        uavs_per_node: int | Sequence[int] | None = None,
        sinks: Sequence[BlockSink] = (),
        resume: Resumption | None = None,
        leaders: int | None = None,
        make_bus: Callable[[MemoryNetwork], Bus] = MemoryNetwork.endpoint,
        realtime: float | None = None,
        **options: Any,
    ) -> None:
        """`sinks`: get the telemetry by a ground station; without any, there is none. `options`: of the run."""
        self.network = MemoryNetwork()
        self.hub: Any = make_bus(self.network)
        options = {"checkpoint_every": engine._checkpoint_every(scenario, realtime) if sinks else 0} | options
        super().__init__(scenario, self.hub, run, resume, realtime=realtime, block_rows=engine._BLOCK_ROWS, **options)
        self.hub.handler = self.nodes.handle
        self.station = None
        if sinks:
            bus = self.network.endpoint()
            first = 0 if resume is None else resume.block + 1
            self.station = RecordingStation(
                bus, run, sinks, first_block=first, uavs=scenario.uavs, nodes=scenario.nodes
            )
            bus.handler = self.station.handle
        size = scenario.uavs if uavs_per_node is None else uavs_per_node
        sizes = [size] * -(-scenario.uavs // size) if isinstance(size, int) else size
        for rows in sizes:
            self.join(Join("agent", rows), Agent)
        for _ in range(plan_of(scenario).leaders(self.world.tick) if leaders is None else leaders):
            self.join(Join("leader", 0), Leader)
        self.gather(10.0)

    def join(self, request: Join, make: Callable[[Welcome], Node]) -> NodeClient:
        """Add another node."""
        bus = self.network.endpoint()
        client = NodeClient(bus, self.run)
        bus.handler = client.handle
        client.join(request, make, timeout_s=1.0)
        return client

    def complete(self) -> dict[str, Any]:
        """Fly the whole flight; its summary."""
        for _ in self.fly():
            pass
        return self.finish()

    def fly(self) -> Iterator[int]:
        if self.station is None:  # nobody acknowledges telemetry
            self.outbox.add = lambda block: None
        return super().fly()
