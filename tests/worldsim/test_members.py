"""Admission: a place for each node, and one place for a node that asks twice."""

import math

import pytest

from meanflock.swarm.wire.messages import Join
from meanflock.worldsim.members import JoinRefused, Members


def test_a_repeated_join_gets_the_same_place() -> None:
    members = Members(3, leaders=1)
    first = members.admit(Join("agent", 1, token=11))
    assert members.admit(Join("agent", 1, token=11)) is first
    assert members.admit(Join("agent", 1, token=12)).uavs.tolist() == [1]
    assert members.admit(Join("leader", 0, token=11)).role == "leader"  # another role is another node
    assert members.admit(Join("agent", 1, token=13)).uavs.tolist() == [2]
    with pytest.raises(JoinRefused, match="every UAV"):
        members.admit(Join("agent", 1, token=14))


def test_a_shut_place_is_refused_and_another_is_given() -> None:
    members = Members(3, leaders=1)
    first, second, _ = (members.admit(Join("agent", 1, uav)) for uav in range(3))
    for lost in (first, second):
        members.lose(lost)
    members.shut(first, 60.0, "was slow")
    with pytest.raises(JoinRefused, match="refused for 50 s: the agent of UAV 0 was slow") as for_now:
        members.admit(Join("agent", 1, 0), 10.0)
    assert members.admit(Join("agent", 2), 10.0).uavs.tolist() == [1]
    with pytest.raises(JoinRefused, match="refused for 50 s"):
        members.admit(Join("agent", 1), 10.0)
    assert members.admit(Join("agent", 1), 60.0).uavs.tolist() == [0]
    leader = members.admit(Join("leader", 0))
    members.lose(leader)
    members.shut(leader, math.inf, "was slow")
    with pytest.raises(JoinRefused, match="refused for good: the leader was slow") as for_good:
        members.admit(Join("leader", 0), 1e9)
    assert (for_now.value.for_now, for_good.value.for_now) == (True, False)
