"""The client of a node: a request heard twice, one that is old, foreign or broken, and the end."""

from typing import Any

import numpy as np

from meanflock.agent.node import Agent
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery, MemoryNetwork
from meanflock.swarm.net.client import NodeClient
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Act, Join, Ready, Sense, Stop
from tests.agent.nodes import NUMBER, RUN, UAVS, flown, sense, states_at, welcome


class World:
    """The other end of a client: welcomes whoever asks, and keeps what it is told."""

    def __init__(self, of: Scenario) -> None:
        network = MemoryNetwork()
        self.said: list[Any] = []
        self.raw: list[bytes] = []
        self._bus = network.endpoint(self._handle)
        self._of = of
        self._bus.answer(keys.join(RUN))
        self._bus.subscribe(keys.act(RUN, "*"))
        endpoint = network.endpoint()
        self.client = NodeClient(endpoint, RUN)
        endpoint.handler = self.client.handle
        self.client.join(Join("agent", 3), Agent, timeout_s=1.0)

    def ask(self, raw: bytes) -> None:
        self._bus.put(keys.sense(RUN, f"agent-{UAVS[0]}"), raw)

    def _handle(self, delivery: Delivery) -> None:
        if delivery.reply is not None:
            delivery.reply(control.encode(welcome(self._of)))
        else:
            self.raw.append(delivery.payload)
            read = wire.read_act if delivery.payload[1:2] in wire.TYPES else control.decode
            self.said.append(read(delivery.payload))


def test_a_node_that_joined_says_it_is_ready() -> None:
    assert [type(message) for message in World(flown()).said] == [Ready]


def test_the_same_sense_twice_gets_the_same_bytes_and_is_learned_once() -> None:
    world, reference = World(flown()), Agent(welcome(flown()))
    for tick in range(3):
        raw = wire.write_sense(sense(tick))
        world.ask(raw)
        world.ask(raw)
        assert world.raw[-1] == world.raw[-2] == wire.write_act(reference.act(sense(tick)))
    assert len(world.raw) == 1 + 6
    assert not world.client.dropped


def test_what_is_old_foreign_or_broken_is_dropped_counted_and_never_answered() -> None:
    world, reference = World(flown()), Agent(welcome(flown()))
    for tick in range(2):
        world.ask(wire.write_sense(sense(tick)))
        expected = wire.write_act(reference.act(sense(tick)))
        assert world.raw[-1] == expected
    answers = len(world.raw)
    good = wire.write_sense(sense(2))
    spoiled = states_at(2)
    spoiled[0, 0] = np.nan
    for raw in (
        wire.write_sense(sense(0)),
        wire.write_sense(Sense(NUMBER ^ 1, 2, states_at(2))),
        control.encode(Ready(NUMBER)),
        control.encode(Stop(NUMBER ^ 1, "not ours")),
        good[:-1],
        good + b"\0",
        b"",
        wire.write_sense(sense(2, states=spoiled)),
        wire.write_sense(sense(2, states=np.zeros((4, 4)))),
        wire.write_sense(sense(2, states=np.zeros((2, 4)))),
        wire.write_sense(sense(2, states=np.zeros((3, 5)))),
        wire.write_act(Act(NUMBER, 2, np.zeros((3, 5)))),
    ):
        world.ask(raw)
    assert len(world.raw) == answers
    assert world.client.dropped == {
        "stale": 1,
        "wrong-run": 2,
        "wrong-kind": 2,
        "malformed": 3,
        "non-finite": 1,
        "wrong-shape": 3,
    }
    world.ask(good)
    assert world.raw[-1] == wire.write_act(reference.act(sense(2)))
    assert world.client.stopped is None


def test_a_stop_of_this_run_ends_the_service() -> None:
    world = World(flown())
    world.ask(control.encode(Stop(NUMBER, "finished")))
    assert world.client.stopped.reason == "finished"
    assert world.client.serve(lambda: False, lambda: False) == "finished"
