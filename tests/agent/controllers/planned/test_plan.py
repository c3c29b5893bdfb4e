"""The plan: profiles, formations and slots, and how it is flown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import meanflock as mf
from meanflock.agent.controllers.cruise import CRUISE_M_S
from meanflock.agent.controllers.planned.plan import Plan, Trajectory, Trapezoid, slots
from meanflock.swarm import declared
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
    positions = np.array([trajectory.states(tick)[:, :2] for tick in range(0, 1000, 5)])
    assert (positions[0] == plan[:, :2]).all()
    assert positions[-1] == pytest.approx(trajectory.slots, abs=1e-9)
    assert np.hypot(*trajectory.slots.T).max() <= 0.84 * scenario.destination.radius + 1e-9
    apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    apart[:, np.arange(uavs), np.arange(uavs)] = np.inf
    ends = min(apart[0].min(), apart[-1].min())
    assert uavs == 1 or apart.min() >= ends - 1e-9
    states, change = trajectory.at(200)
    assert np.hypot(*states[:, 2:].T) == pytest.approx(CRUISE_M_S, rel=0.05)
    assert (change == 0.0).all()


def test_slots_are_the_formation_of_the_uavs_with_the_same_goal_made_smaller() -> None:
    starts = np.array([[0.0, 0.0], [2.0, 0.0], [100.0, 0.0], [100.0, 80.0], [5.0, 5.0]])
    goals = np.array([[9.0, 9.0], [9.0, 9.0], [-9.0, 0.0], [-9.0, 0.0], [1.0, 2.0]])
    ends = slots(starts, goals, 4.0)
    assert ends == pytest.approx(np.array([[8, 9], [10, 9], [-9, -4], [-9, 4], [1, 2]]))


def test_without_noise_it_keeps_to_its_trajectory() -> None:
    waves = {"start.formation": "waves", "start.group": 5, "start.interval": 3.0, "wind.sigma": 0.0}
    run = mf.fly("paper", method="plan", uavs=9, stop="duration", duration=115, **waves)
    plan: Plan = declared.controller(run.scenario)
    wanted = np.array(
        [
            plan.prediction().now(np.zeros((1, 4, 9)), np.zeros((1, 9), np.int32), slice(None), tick)[0].T
            for tick in range(len(run.states))
        ]
    )
    assert np.abs(run.states - wanted).max() < 0.12  # a tick at full acceleration, and the ends of the trapezoid
    assert np.abs(run.states[-1] - wanted[-1]).max() < 1e-6
    assert not run.states[-1, :, 2:].round(6).any()
    first = (np.hypot(run.states[..., 2], run.states[..., 3]) > 1e-3).argmax(axis=0)
    assert (first - first[0]).tolist() == [0] * 5 + [30] * 4  # the clock starts when a UAV leaves the ground


@pytest.mark.parametrize("uavs", [1, 25])
def test_all_arrive_together_apart_and_in_silence(uavs: int) -> None:
    run = mf.fly("paper", method="plan", uavs=uavs)
    summary = run.summary
    assert summary["arrived"] == uavs
    assert summary["collisions"] == 0
    assert summary["t_max_s"] - summary["t_avg_s"] < 3.0
    assert summary["radio"]["traffic"]["state"]["sent"] == 0
