"""A node that is lost costs nobody else anything, and another may take its place."""

import numpy as np
import pytest

from meanflock.net import keys
from meanflock.net.bus import Delivery
from meanflock.net.members import JoinRefused, Members
from meanflock.net.networked import NetworkedRun
from meanflock.swarm.errors import BadInput, BusError, Refused
from meanflock.swarm.plugins import registry
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Join, Ready, Status
from tests.faults.conftest import RUN, Lab, scenario
from tests.memory_swarm import MemorySwarm


def test_several_agents_take_over_the_uavs_of_one_lost_node_until_none_is_free() -> None:
    lab = Lab(scenario(), uavs_per_node=3)

    def rejoin() -> None:
        for _ in range(3):
            lab.agent()
        with pytest.raises(BusError, match="refused"):
            lab.agent()

    summary = lab.fly({10: lambda: lab.kill("agent-3"), 20: rejoin})
    assert summary["lost"] == 0
    assert [event.uavs for event in lab.record.events if event.kind == "rejoined"] == [(3,), (4,), (5,)]


def test_a_uav_keeps_its_arrival_when_its_agent_is_replaced() -> None:
    lab = Lab(scenario("start.centre=[0.0, 0.0]", "start.spacing=0.5"), uavs_per_node=1)
    summary = lab.fly({30: lambda: lab.kill("agent-4"), 40: lab.agent})
    assert lab.world.flight.arrival_tick[4] > 0
    assert lab.world.flight.status[4] == Status.ARRIVED
    assert summary["arrived"] == 6


def test_an_agent_that_rejoins_knows_the_mission_plan_and_takes_the_next_global_model_from_the_radio() -> None:
    lab = Lab(scenario(), uavs_per_node=1)
    models: dict[int, list[np.ndarray]] = {}

    def look() -> None:
        agents = [lab.client_of(name) for name in ("agent-0", "agent-2.2")]
        models[lab.world.flight.tick] = [agent._node.models[0].copy() for agent in agents]

    def join() -> None:
        lab.agent()
        look()

    lab.fly({25: lambda: lab.kill("agent-2"), 30: join, 42: look, 43: look})
    old, new = models[30]
    assert (old[:108].any(), new[:108].any(), new[108:177].any()) == (True, False, True)
    before, after = (np.abs(one[:108] - other[:108]).max() for one, other in (models[42], models[43]))
    # Round 2 was averaged in tick 41 and received in tick 42: both began that tick with the same value model.
    assert after < before / 5


def test_a_flight_without_rounds_does_not_wait_for_a_leader_and_does_not_tell_when_it_comes() -> None:
    lab = Lab(scenario(method="orca"), uavs_per_node=3, leaders=0)
    summary = lab.fly({5: lab.leader})
    assert summary["nodes_rejoined"] == 0
    assert [event.text for event in lab.record.events if event.kind in ("joined", "rejoined")] == [
        "2 nodes hold 6 UAVs"
    ]


@pytest.mark.parametrize(("flies", "count"), [(False, 0), (True, 1)])
def test_a_leader_of_a_flight_without_rounds_rejoins_if_one_was_lost_in_flight(monkeypatch, flies, count) -> None:
    def gather(swarm: MemorySwarm, timeout_s: float) -> None:
        """The leader is lost before the swarm takes off."""
        (bus,) = (bus for bus in swarm.network.endpoints if keys.sense(RUN, "leader") in bus._subscriptions)
        bus.close()
        NetworkedRun.gather(swarm, timeout_s)

    if not flies:
        monkeypatch.setattr(MemorySwarm, "gather", gather)
    lab = Lab(scenario(method="orca"), uavs_per_node=3)
    summary = lab.fly({5: lab.leader} if not flies else {3: lambda: lab.kill("leader"), 5: lab.leader})
    assert (summary["nodes_lost"], summary["nodes_rejoined"]) == (count, count)
    assert [event.text for event in lab.record.events if event.kind == "rejoined"] == ["leader.2 stands by"] * count


@pytest.mark.parametrize("place", ["agent-3", "leader"])
@pytest.mark.parametrize(("every", "rejoins"), [(3, 5), (7, 8)])
def test_a_node_that_rejoins_too_often_is_refused_for_good_and_no_other_node_is(place, every, rejoins) -> None:
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
        assert told == [f"{place}.6 rejoined for the last time: its place stays closed after the next loss"]
        assert "refused for good: the " in refused[0]
        assert "joined again 5 times within 20 ticks, the most that `pace.rejoins` and" in refused[0]
        assert summary["lost"] == (place != "leader")


def test_a_node_that_never_becomes_ready_frees_its_place_in_flight() -> None:
    clock = [0.0]
    lab = Lab(scenario(), uavs_per_node=1)
    lab.now = lambda: clock[0]

    def half() -> None:
        answers: list[bytes] = []
        raw = control.encode(Join("agent", 1))
        lab.engine.nodes.handle(Delivery("question", keys.join(RUN, "agent"), raw, answers.append))
        assert control.decode(answers[0]).node == "agent-5.2"

    def patience_ends() -> None:
        clock[0] += 11.0

    summary = lab.fly({10: lambda: lab.kill("agent-5"), 20: half, 30: patience_ends, 32: lab.agent})
    assert summary["lost"] == 0
    assert [event.tick for event in lab.record.events if event.kind == "rejoined"] == [32]


def test_a_lost_node_that_speaks_again_is_sent_home_and_its_successor_is_not() -> None:
    lab = Lab(scenario(), uavs_per_node=1)
    old, client = lab.bus_of("agent-1"), lab.client_of("agent-1")

    def thaw() -> None:
        old.handler = client.handle
        old.put(keys.act(RUN, "agent-1"), control.encode(Ready(keys.fingerprint(RUN))))
        assert client.stopped.lost

    def freeze() -> None:
        old.handler = lambda delivery: None  # it hears nothing of its loss
        lab.engine.nodes.handle(Delivery("gone", keys.alive(RUN, "agent", "agent-1")))

    summary = lab.fly({20: freeze, 40: lab.agent, 60: thaw})
    assert (summary["lost"], summary["nodes_lost"]) == (0, 1)
    assert summary["dropped_messages"] == {"unknown-node": 1}


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("controller", "mfgfl-h", "is not installed here"),
        ("controller", "mfgfl-h", "is of sha256 of another file here, and of"),
        ("filter", "ecbf", "is of sha256 of another file here, and of"),
    ],
)
def test_an_agent_without_a_plugin_is_refused_with_its_host_and_another_rejoins(kind, name, said, monkeypatch) -> None:
    lab, text = Lab(scenario("filter.kind=ecbf"), uavs_per_node=1), f"on host far-away: {kind} '{name}' {said}"

    def stranger() -> None:
        packaged = registry._packaged()
        other = tuple(plugin._replace(fingerprint="sha256 of another file") for plugin in packaged[kind, name])
        with monkeypatch.context() as patch:
            patch.setattr("platform.node", lambda: "far-away")
            patch.setitem(packaged, (kind, name), other if "another" in said else ())
            with pytest.raises(BadInput, match=text):
                lab.agent()

    summary = lab.fly({10: lambda: lab.kill("agent-5"), 20: stranger, 30: lab.agent})
    assert (summary["lost"], summary["nodes_rejoined"], summary["dropped_messages"]) == (0, 1, {})
    assert any(text in event.text for event in lab.record.events if event.kind == "lost")


def test_a_repeated_join_gets_the_same_place() -> None:
    members = Members(3, leaders=1)
    first = members.admit(Join("agent", 1, token=11))
    assert members.admit(Join("agent", 1, token=11)) is first
    assert members.admit(Join("agent", 1, token=12)).uavs.tolist() == [1]
    assert members.admit(Join("leader", 0, token=11)).role == "leader"  # another role is another node
    assert members.admit(Join("agent", 1, token=13)).uavs.tolist() == [2]
    with pytest.raises(JoinRefused, match="every UAV"):
        members.admit(Join("agent", 1, token=14))


def test_where_every_uav_averages_for_itself_a_leader_is_sent_home_for_good() -> None:
    members = Members(3, leaders=0, leaderless=True)
    with pytest.raises(JoinRefused, match="no leader is needed") as caught:
        members.admit(Join("leader", 0, token=11))
    assert (caught.value.over, caught.value.for_now) == (True, False)
    assert "leader" not in members.missing()
