"""A node that is lost costs nobody else anything, and another may take its place."""

from contextlib import suppress

import numpy as np
import pytest

from meanflock.agent.node import Agent
from meanflock.leader.node import Leader
from meanflock.swarm.errors import BusError, Refused, RunFailed
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery, MemoryNetwork
from meanflock.swarm.net.client import NodeClient
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Join, Ready, Status, Stop
from meanflock.worldsim.world import World
from tests.faults.conftest import RUN, Lab, scenario

NUMBER = keys.fingerprint(RUN)


def test_an_agent_that_joins_while_uavs_are_lost_takes_them_over_and_they_fly_again() -> None:
    lab = Lab(scenario(), uavs_per_node=1)
    seen = {}

    def kill() -> None:
        lab.kill("agent-2")
        seen["lost"] = lab.world.flight.status.tolist()

    def rejoin() -> None:
        lab.agent()
        seen["rejoined"] = lab.world.flight.status.tolist()

    summary = lab.fly({30: kill, 50: rejoin})
    assert seen["lost"] == [0, 0, Status.LOST, 0, 0, 0]
    assert seen["rejoined"] == [0] * 6
    assert (summary["lost"], summary["nodes_lost"], summary["ticks"]) == (0, 1, 120)
    assert lab.record.kinds("lost", "rejoined") == [(30, "lost"), (50, "rejoined")]
    commands = np.concatenate([block.accelerations for block in lab.record.blocks])
    assert not commands[31:51, 2].any()
    assert commands[52:, 2].any(axis=-1).all()


def test_several_uavs_of_one_lost_node_are_taken_over_by_several_agents_until_none_is_free() -> None:
    lab = Lab(scenario(), uavs_per_node=3)

    def rejoin() -> None:
        for _ in range(3):
            lab.agent()
        with pytest.raises(BusError, match="refused"):
            lab.agent()

    summary = lab.fly({10: lambda: lab.kill("agent-3"), 20: rejoin})
    assert summary["lost"] == 0
    assert [event.uavs for event in lab.record.events if event.kind == "rejoined"] == [(3,), (4,), (5,)]


def test_a_uav_that_had_arrived_has_arrived_still_after_its_agent_came_back() -> None:
    lab = Lab(scenario("start.centre=[0.0, 0.0]", "start.spacing=0.5"), uavs_per_node=1)
    summary = lab.fly({30: lambda: lab.kill("agent-4"), 40: lab.agent})
    assert lab.world.flight.arrival_tick[4] > 0
    assert lab.world.flight.status[4] == Status.ARRIVED
    assert summary["arrived"] == 6


def test_an_agent_that_rejoins_knows_the_mission_plan_and_takes_the_next_global_model_from_the_radio() -> None:
    lab = Lab(scenario(), uavs_per_node=1)
    weights_at: dict[str, np.ndarray] = {}

    def weights_of(name: str) -> np.ndarray:
        client = lab.bus_of(name).handler.__self__  # type: ignore[union-attr]
        assert isinstance(client._node, Agent)
        return client._node.models[0].copy()

    def before() -> None:
        weights_at["old"] = weights_of("agent-0")
        lab.agent()
        weights_at["fresh"] = weights_of("agent-2.2")

    apart = {}

    def compare(tick: int) -> None:
        apart[tick] = float(np.abs(weights_of("agent-0")[:108] - weights_of("agent-2.2")[:108]).max())

    lab.fly({25: lambda: lab.kill("agent-2"), 30: before, 42: lambda: compare(42), 43: lambda: compare(43)})
    assert not weights_at["fresh"][:108].any()
    assert weights_at["fresh"][108:177].any()
    assert weights_at["old"][:108].any()
    # Round 2 was averaged in tick 41 and heard in tick 42: both began that tick with the same value model.
    assert apart[43] < apart[42] / 5


@pytest.mark.parametrize("place", ["agent-3", "leader"])
@pytest.mark.parametrize(("every", "rejoins"), [(3, 5), (7, 8)])
def test_a_node_that_rejoins_five_times_within_some_ticks_is_refused_for_good_and_no_other_is(
    place: str, every: int, rejoins: int
) -> None:
    lab = Lab(scenario("pace.rejoin_ticks=20"), uavs_per_node=1)
    names = iter([place, *(f"{place}.{life}" for life in range(2, 10))])
    refused = []

    def again() -> None:
        if not refused:
            lab.kill(next(names))
            try:
                lab.leader() if place == "leader" else lab.agent()
            except Refused as error:
                refused.append(str(error))

    def honest() -> None:
        lab.kill("agent-5")
        lab.agent()

    summary = lab.fly({**dict.fromkeys(range(20, 20 + 8 * every, every), again), 100: honest})
    told = [event.text for event in lab.record.events if event.kind == "refused"]
    assert summary["nodes_rejoined"] == rejoins + 1
    if every == 7:
        assert (refused, told) == ([], [])
    else:
        assert told == [f"{place}.6 rejoined for the last time: nobody may take its place again"]
        assert "refused for good: the " in refused[0]
        assert "joined again 5 times within 20 ticks, the most that `pace.rejoins` and" in refused[0]
        assert summary["lost"] == (place != "leader")


def test_the_old_process_that_comes_back_is_refused_and_told_to_go_home_and_its_successor_is_not() -> None:
    lab = Lab(scenario(), uavs_per_node=1)
    old = lab.bus_of("agent-1")
    client = old.handler.__self__  # type: ignore[union-attr]
    heard = []

    def freeze() -> None:
        old.handler = heard.append
        lab.world.handle(Delivery("gone", keys.alive(RUN, "agent", "agent-1")))

    def thaw() -> None:
        client.stopped = None
        old.handler = client.handle
        before = lab.world.counters.drops.copy()
        old.put(keys.act(RUN, "agent-1"), control.encode(Act(NUMBER, 60, np.zeros((1, 5)))))
        assert lab.world.counters.drops - before == {"unknown-node": 1}
        assert client.stopped.lost
        client.stopped = None
        old.put(keys.act(RUN, "agent-1"), control.encode(Ready(NUMBER)))
        assert client.stopped.lost
        client.stopped = None
        lab.world.handle(Delivery("alive", keys.alive(RUN, "agent", "agent-1")))
        assert client.stopped.lost

    successor = {}
    summary = lab.fly({20: freeze, 40: lambda: successor.update(client=lab.agent()), 60: thaw})
    assert isinstance(control.decode(heard[0].payload), Stop)
    assert not [d for d in heard if not isinstance(control.decode(d.payload), Stop)]
    assert summary["lost"] == 0
    assert (successor["client"].stopped.reason, successor["client"].stopped.lost) == ("finished", False)


def test_a_node_that_was_admitted_and_never_became_ready_frees_its_place_for_another() -> None:
    clock = [0.0]
    lab = Lab(scenario(), uavs_per_node=1)
    lab.world._admission._clock = lambda: clock[0]

    def half() -> None:
        answers: list[bytes] = []
        raw = control.encode(Join("agent", 1))
        lab.world.handle(Delivery("question", keys.join(RUN, "agent"), raw, answers.append))
        assert control.decode(answers[0]).node == "agent-5.2"  # type: ignore[union-attr]

    def patience_ends() -> None:
        clock[0] += 11.0

    summary = lab.fly({10: lambda: lab.kill("agent-5"), 20: half, 30: patience_ends, 32: lab.agent})
    assert summary["lost"] == 0
    assert [event.tick for event in lab.record.events if event.kind == "rejoined"] == [32]


def test_who_was_admitted_and_is_ready_only_after_the_flight_is_sent_home_all_the_same() -> None:
    lab = Lab(scenario(), uavs_per_node=1)
    late = lab.engine.network.endpoint()

    def half() -> None:
        raw = control.encode(Join("agent", 1))
        lab.world.handle(Delivery("question", keys.join(RUN, "agent"), raw, lambda answer: None))

    lab.fly({10: lambda: lab.kill("agent-5"), 100: half})
    late.subscribe(keys.sense(RUN, "agent-5.2"))  # only now: what the world said at the end it has not heard
    late.put(keys.act(RUN, "agent-5.2"), control.encode(Ready(NUMBER)))
    heard = late.receive(0.0)
    assert heard is not None
    stop = control.decode(heard.payload)
    assert isinstance(stop, Stop)
    assert (stop.run, stop.reason) == (NUMBER, "finished")


def test_who_is_lost_before_take_off_is_missing_and_another_takes_the_place() -> None:
    network = MemoryNetwork()
    hub = network.endpoint()
    world = World(scenario("uavs=1"), hub, RUN)
    hub.handler = world.handle
    for request, make in ((Join("agent", 1), Agent), (Join("leader", 0), Leader), (Join("agent", 1), Agent)):
        bus = network.endpoint()
        client = NodeClient(bus, RUN)
        bus.handler = client.handle
        client.join(request, make, 1.0)  # type: ignore[arg-type]
        if request.role == "leader":
            assert "every UAV" not in world._admission.missing
        elif not world.members.complete:
            first = bus
            first.close()
            assert "1 UAVs without an agent" in world._admission.missing
    world.gather(0.0)
    for _ in world.fly():
        pass
    assert world.finish(lambda: 0.0)["lost"] == 0


def test_a_node_that_was_let_in_and_never_got_ready_does_not_keep_all_others_on_the_ground(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network = MemoryNetwork()
    hub, stranger, bus = (network.endpoint() for _ in range(3))
    now = 0.0
    world = World(scenario("uavs=1", method="cruise"), hub, RUN, clock=lambda: now)
    hub.handler = world.handle
    monkeypatch.setattr(world, "_wait", lambda timeout_s: None)
    assert stranger.ask(keys.join(RUN, "agent"), control.encode(Join("agent", 1)), 1.0) is not None
    client = NodeClient(bus, RUN)
    bus.handler = client.handle

    def tries() -> bool:
        nonlocal now
        now += 1.0
        with suppress(BusError):
            client.join(Join("agent", 1), Agent, 0.0)
        return False

    world.gather(60.0, tries)
    assert now < 40.0
    assert [member.name for member in world.members.present] == ["agent-0.2"]


def test_two_nodes_lost_at_the_same_barrier_do_not_hold_up_the_end_of_a_mission_that_waits_for_arrivals() -> None:
    lab = Lab(scenario("uavs=2", "stop=arrival", "federation.period=1000"), uavs_per_node=1)
    times = iter(range(10**9))
    lab.world._waiting._clock = lambda: float(next(times))

    def deaf() -> None:
        for name in ("agent-0", "agent-1"):
            bus = lab.bus_of(name)
            bus.handler = lambda delivery: None
            (key,) = bus._subscriptions
            bus.subscribe(key)

    lab.world._waiting._receive = lambda timeout_s: None
    with pytest.raises(RunFailed, match="every agent is lost"):
        lab.fly({5: deaf})
    assert lab.record.kinds("lost", "failed", "finished") == [(5, "lost"), (5, "lost"), (6, "failed")]
