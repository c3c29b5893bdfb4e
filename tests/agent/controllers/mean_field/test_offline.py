"""The offline plan: within its limits, exact without wind, blind with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.agent.controllers.mean_field.offline import OpenLoopPlan, speeds
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.vehicles.point_mass import PointMass

SPACING = "start.spacing=6"


def flown(scenario: Scenario) -> Engine:
    engine = Engine(scenario, "test")
    for _ in engine.fly():
        pass
    return engine


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


def test_long_way_takes_the_time_of_bang_coast_bang() -> None:
    ticks = len(speeds(180.0, 15.0, 3.0, 0.1))
    assert ticks * 0.1 == pytest.approx(180.0 / 15.0 + 15.0 / 3.0, abs=0.2)


def test_short_way_never_coasts() -> None:
    profile = speeds(12.0, 15.0, 3.0, 0.1)
    assert len(profile) * 0.1 == pytest.approx(2 * np.sqrt(12.0 / 3.0), abs=0.2)
    assert profile.max() == pytest.approx(np.sqrt(12.0 * 3.0), rel=0.02)


def test_no_way_to_go_is_no_plan() -> None:
    assert len(speeds(0.0, 15.0, 3.0, 0.1)) == 0


def test_without_randomness_the_discrete_motion_ends_at_rest_at_the_origin() -> None:
    scenario = load(None, ["wind.sigma=0"], method="offline")
    states = starts(scenario)
    plan, vehicle = OpenLoopPlan(scenario, states), PointMass(PointMass.Options(), scenario)
    straight = -states[:, state.POSITION] / np.linalg.norm(states[:, state.POSITION], axis=-1, keepdims=True)
    for tick in range(len(plan) + 20):
        states, _ = vehicle.step(states, {}, plan(tick), np.zeros((25, 2)))
        across = states[:, state.X] * straight[:, 1] - states[:, state.Y] * straight[:, 0]
        assert np.abs(across).max() < 1e-9
    assert np.abs(states).max() < 1e-9


def test_path_is_the_straight_one_of_180_metres_and_all_arrive() -> None:
    world = flown(load(None, ["wind.sigma=0", "stop=duration", "duration=20"], method="offline")).world
    assert (world.flight.arrival_tick > 0).all()
    travelled = world.flight.distance.mean()  # until ‖s‖ ≤ 5, some metres before the origin
    assert 170 < travelled < np.hypot(150, 100)


def test_separated_starts_do_not_collide_without_wind_and_do_with_it() -> None:
    assert flown(load(None, ["wind.sigma=0", SPACING], method="offline")).world.flight.collisions == 0
    windy = [load(None, [SPACING], method="offline", seed=seed, duration=40.0) for seed in range(1, 6)]
    assert sum(flown(scenario).world.flight.collisions for scenario in windy) > 0


def test_the_papers_spacing_is_too_close_for_straight_lines_to_one_point() -> None:
    assert flown(load(None, ["wind.sigma=0"], method="offline")).world.flight.collisions > 0


def test_nothing_is_learned_and_nothing_said_but_the_mission_plan() -> None:
    engine = flown(load(None, method="offline", uavs=4, duration=30.0))
    record = engine.world.finish()
    assert record["payload_bits"]["total"] == record["payload_bits"]["state"] == 4 * 4 * 32
    assert record["radio"]["sent"] == 0
    assert record["fpk_residual_max"] is None
    declared = engine.world._declared
    assert (declared.parameters, declared.weights, declared.diagnostics) == (0, 0, ())
    assert not declared.is_federated


def test_blind_to_the_wind() -> None:
    calm = OpenLoopPlan(load(None, ["wind.sigma=0"], method="offline"), starts(load(None)))
    windy = OpenLoopPlan(load(None, ["wind.sigma=2"], method="offline"), starts(load(None)))
    for tick in (0, 50, 100, 10_000):
        np.testing.assert_array_equal(calm(tick), windy(tick))


def test_rows_do_not_know_of_each_other() -> None:
    scenario = load(None, method="offline")
    states = starts(scenario)
    together, alone = OpenLoopPlan(scenario, states), OpenLoopPlan(scenario, states[7:8])
    for tick in range(0, 200, 7):
        np.testing.assert_array_equal(together(tick)[7:8], alone(tick))
