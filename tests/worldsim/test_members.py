"""Who is let in: a place for each, and one place for who asks twice."""

import math

import numpy as np
import pytest

from meanflock.swarm.wire.messages import Join
from meanflock.worldsim.members import JoinRefused, Members


def test_who_asks_again_without_having_heard_the_answer_is_told_the_same() -> None:
    members = Members(3, leaders=1)
    first = members.admit(Join("agent", 1, token=11))
    assert members.admit(Join("agent", 1, token=11)) is first
    assert members.admit(Join("agent", 1, token=12)).uavs.tolist() == [1]
    assert members.admit(Join("leader", 0, token=11)).role == "leader"  # another role is another node
    assert members.admit(Join("agent", 1, token=13)).uavs.tolist() == [2]
    with pytest.raises(JoinRefused, match="every UAV"):
        members.admit(Join("agent", 1, token=14))


def test_who_asks_again_for_its_own_uav_is_not_refused_for_having_it() -> None:
    members = Members(4, leaders=0)
    own = members.admit(Join("agent", 2, 2, token=5))
    assert members.admit(Join("agent", 2, 2, token=5)) is own
    with pytest.raises(JoinRefused, match="UAV 2"):
        members.admit(Join("agent", 2, 2, token=6))


def test_a_token_is_no_way_back_in_once_its_node_listens_or_is_lost_and_none_is_nobody_s() -> None:
    members = Members(4, leaders=0)
    for token in (7, 8):
        held = members.admit(Join("agent", 1, token=token))
        if token == 7:
            held.ready = True
        else:
            members.lose(held)
        assert members.admit(Join("agent", 1, token=token)) is not held
    anonymous = [members.admit(Join("agent", 1)) for _ in range(1)]
    with pytest.raises(JoinRefused):
        members.admit(Join("agent", 1))
    assert np.concatenate([member.uavs for member in members.present]).tolist() == [0, 1, 2, 3]
    assert anonymous[0] in members.present


def test_nobody_takes_a_place_that_is_shut_and_whoever_asks_for_any_is_given_another() -> None:
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
