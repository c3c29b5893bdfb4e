"""The offline plan: within its limits, exact without wind, blind to it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.agent.controllers.mean_field.offline import OpenLoopPlan, speeds
from meanflock.swarm import state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import load
from meanflock.worldsim.vehicles.point_mass import PointMass


@given(
    distance=st.floats(0.01, 500.0),
    speed_max=st.floats(0.5, 50.0),
    acceleration_max=st.floats(0.1, 30.0),
    dt=st.floats(0.05, 1.0),
)
def test_profile_covers_the_distance_within_the_limits_and_no_faster_one_would(
    distance: float, speed_max: float, acceleration_max: float, dt: float
) -> None:
    profile = speeds(distance, speed_max, acceleration_max, dt)
    assert profile.sum() * dt == pytest.approx(distance, rel=1e-9)
    assert profile.max() <= speed_max * (1 + 1e-12)
    from_rest = np.concatenate([[0.0], profile])
    assert np.abs(np.diff(from_rest)).max() <= acceleration_max * dt * (1 + 1e-9)
    assert profile[-1] == pytest.approx(0.0, abs=1e-12)
    ticks = len(profile) - 1
    k = np.arange(1, ticks + 1)
    reach = np.minimum(np.minimum(k, ticks - k) * (acceleration_max * dt), speed_max).sum() * dt
    assert reach < distance


def test_without_randomness_the_discrete_motion_ends_at_rest_at_the_origin() -> None:
    scenario = load(None, ["wind.sigma=0"], method="offline")
    states = starts(scenario)
    plan, vehicle = OpenLoopPlan(scenario, states), PointMass(PointMass.Options(), scenario)
    straight = -states[:, state.POSITION] / np.linalg.norm(states[:, state.POSITION], axis=-1, keepdims=True)
    assert len(plan) * 0.1 == pytest.approx(np.linalg.norm([150, 100]) / 15 + 15 / 3, abs=0.5)  # bang, coast, bang
    for tick in range(len(plan) + 20):
        states, _ = vehicle.step(states, {}, plan(tick), np.zeros((25, 2)))
        across = states[:, state.X] * straight[:, 1] - states[:, state.Y] * straight[:, 0]
        assert np.abs(across).max() < 1e-9
    assert np.abs(states).max() < 1e-9


def test_the_plan_is_blind_to_the_wind_and_reports_nothing() -> None:
    assert load(None, method="offline").declared.diagnostics == ()
    assert len(speeds(0.0, 15.0, 3.0, 0.1)) == 0  # of a UAV that starts at its goal
    calm = OpenLoopPlan(load(None, ["wind.sigma=0"], method="offline"), starts(load(None)))
    windy = OpenLoopPlan(load(None, ["wind.sigma=2"], method="offline"), starts(load(None)))
    for tick in (0, 50, 100, 10_000):
        np.testing.assert_array_equal(calm(tick), windy(tick))
