"""Concurrent trajectories: from rest to rest within their limits, exact derivatives, and UAVs keep apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.agent.controllers.cruise import CRUISE_M_S
from meanflock.agent.controllers.planned.plan import Trajectory, Trapezoid, slots
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario


@given(length=st.floats(0.0, 500.0), cruise=st.floats(0.1, 20.0), up=st.floats(0.1, 5.0), down=st.floats(0.1, 5.0))
def test_a_way_is_covered_from_rest_to_rest_within_the_limits(
    length: float, cruise: float, up: float, down: float
) -> None:
    profile = Trapezoid(np.array([length]), cruise, up, down)
    end = float(profile.duration_s[0])
    times = np.linspace(0.0, end, 200)
    covered, speed, change = np.array([profile.at(t) for t in times])[..., 0].T
    assert covered[0] == 0.0
    assert covered[-1] == pytest.approx(length, abs=1e-9)
    assert (np.diff(covered) >= -1e-9).all()
    assert speed.max() <= cruise * (1 + 1e-12)
    assert change.max() <= up
    assert change.min() >= -down
    # the speed is the slope of the way: the trapezoid rule is exact but in the two intervals with a corner
    slope = 0.5 * (speed[1:] + speed[:-1]) * np.diff(times)
    corner = (up + down) * (end / 199) ** 2
    assert np.abs(np.diff(covered)[:-1] - slope[:-1]).max(initial=0.0) <= corner + 1e-9
    for before_or_after in (-1.0, end + 1.0):
        assert [float(part[0]) for part in profile.at(before_or_after)[1:]] == [0.0, 0.0]


@pytest.mark.parametrize("uavs", [1, 25, 64])
def test_all_uavs_arrive_together_and_keep_apart(uavs: int) -> None:
    scenario = Scenario(uavs=uavs)
    plan = starts(scenario)
    trajectory = Trajectory(scenario, plan)
    positions = np.array([trajectory.at(tick)[0] for tick in range(0, 1000, 5)])
    assert (positions[0] == plan[:, :2]).all()
    assert positions[-1] == pytest.approx(trajectory.slots, abs=1e-9)
    assert np.hypot(*trajectory.slots.T).max() <= 0.84 * scenario.destination.radius + 1e-9
    apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    apart[:, np.arange(uavs), np.arange(uavs)] = np.inf
    ends = min(apart[0].min(), apart[-1].min())
    assert uavs == 1 or apart.min() >= ends - 1e-9
    _, velocity, change = trajectory.at(200)
    assert np.hypot(*velocity.T) == pytest.approx(CRUISE_M_S, rel=0.05)
    assert (change == 0.0).all()


def test_slots_are_the_formation_of_the_uavs_with_the_same_goal_made_smaller() -> None:
    starts = np.array([[0.0, 0.0], [2.0, 0.0], [100.0, 0.0], [100.0, 80.0], [5.0, 5.0]])
    goals = np.array([[9.0, 9.0], [9.0, 9.0], [-9.0, 0.0], [-9.0, 0.0], [1.0, 2.0]])
    ends = slots(starts, goals, 4.0)
    assert ends == pytest.approx(np.array([[8, 9], [10, 9], [-9, -4], [-9, 4], [1, 2]]))
