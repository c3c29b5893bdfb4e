"""Flights in space: motion, wind, gusts, encounters, the ground, and the radio; closed forms and cases by hand."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock import env
from meanflock.channel.base import in_space
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.base import MeanWind

CALM = {"wind.sigma": 0.0, "wind.drag": 0.0, "space.dimensions": 3}
SWAP: dict[str, Any] = {
    "method": "cruise",
    "uavs": 7,
    "duration": 12.0,
    "start.formation": "sphere",
    "start.centre": (0.0, 0.0),
    "destination.goals": "opposite",
    "destination.radius": 1.0,
    "controller.speed_m_s": 6.0,
    "space.dimensions": 3,
}


def flight_of(*places: tuple[float, ...], **keys: Any) -> Flight:
    """A flight without wind from some places, all of them on the way to (0, 0, 40)."""
    return Flight(Scenario(uavs=len(places), start={"positions": places}, **CALM, **keys))


def commanded(flight: Flight, *accelerations: tuple[float, float, float]) -> None:
    flight.advance(np.array(accelerations))


def test_a_uav_falls_as_it_is_commanded_and_stays_on_the_ground() -> None:
    flight = flight_of((50.0, 0.0, 1.0))
    for _ in range(30):
        commanded(flight, (0.5, 0.0, -1.0))
    assert flight.states[0, 2] == 0.0
    assert flight.states[0, 5] <= 0.0
    assert flight.states[0, 3] == pytest.approx(30 * 0.05)
    assert flight.ground.touched.tolist() == [True]
    assert [event.kind for event in flight.events].count("grounded") == 1
    assert "UAV 0 hit the ground" in [event.text for event in flight.events]
    rested = flight.states[0, 2:6:3].tolist()
    commanded(flight, (0.0, 0.0, -1.0))
    assert flight.states[0, 2:6:3].tolist() == rested == [0.0, 0.0]


def test_a_take_off_from_the_ground_and_a_landing_at_the_goal_are_no_hits() -> None:
    flight = flight_of((1.0, 0.0, 0.0), destination={"positions": ((0.0, 0.0, 0.0),), "radius": 2.0}, stop="duration")
    for push in (*[1.0] * 10, *[-1.0] * 40):
        commanded(flight, (0.0, 0.0, push))
    assert flight.states[0, 2] == 0.0
    assert flight.arrival_tick[0] > 0
    assert not flight.ground.touched.any()


def test_a_uav_that_has_not_left_the_ground_is_not_grounded() -> None:
    flight = flight_of((50.0, 0.0, 0.0))
    for _ in range(5):
        commanded(flight, (1.0, 0.0, -1.0))
    assert not flight.ground.touched.any()


def test_uavs_one_above_the_other_do_not_collide_and_those_that_cross_do() -> None:
    flight = flight_of((0.0, 50.0, 40.0), (0.0, 50.0, 41.0))
    assert flight.encounters.closest_approach_m == pytest.approx(1.0)
    for _ in range(10):
        commanded(flight, (0.0, 0.0, 3.0), (0.0, 0.0, -3.0))
    assert flight.collisions == 1
    assert flight.encounters.closest_approach_m == pytest.approx(0.0, abs=1e-12)


def test_an_obstacle_is_a_column() -> None:
    flight = flight_of((3.0, 50.0, 90.0), obstacles=[{"centre": (5.0, 50.0), "radius": 1.0}])
    for _ in range(15):
        commanded(flight, (2.0, 0.0, 0.0))
    assert flight.encounters.hit.tolist() == [[True]]


def test_arrival_takes_all_axes() -> None:
    flight = flight_of((0.0, 0.0, 46.0), (0.0, 0.0, 44.0))
    commanded(flight, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert flight.arrival_tick.tolist() == [-1, 1]


def test_commands_are_limited_as_a_whole() -> None:
    flight = flight_of((0.0, 50.0), vehicle={"acceleration_max": 7.0})
    commanded(flight, (2.0, 3.0, 6.0))
    assert flight.clipped == 0
    commanded(flight, (4.0, 6.0, 12.0))
    assert flight.clipped == 1
    np.testing.assert_allclose(state.velocity(flight.states)[0], [0.4, 0.6, 1.2])


def test_the_power_of_a_level_flight_is_that_of_the_plane() -> None:
    flat, space = (mf.fly(Scenario(**{**CALM, "space.dimensions": d}, method="cruise", uavs=4)) for d in (2, 3))
    assert space.summary["energy_mean_J"] == flat.summary["energy_mean_J"]
    np.testing.assert_array_equal(space.states[..., [0, 1, 3, 4]], flat.states)
    assert (space.states[..., 2] == 40.0).all()
    assert space.summary["payload_bits"]["total"] == flat.summary["payload_bits"]["total"] * 6 // 4
    assert flat.summary["grounded"] is None
    assert space.summary["grounded"] == 0


def test_a_wind_of_three_numbers_and_a_gust_carry_upwards() -> None:
    wind = {"mean": (0.0, 0.0, 2.0), "drag": 1.0, "sigma": 0.0}
    gust = {"kind": "gust", "tick": 0, "duration_s": 100.0, "acceleration": (0.0, 0.0, 1.0)}
    flown = mf.fly(Scenario(uavs=1, method="cruise", duration=2.0, wind=wind, space={"dimensions": 3}, faults=[gust]))
    # The controller cancels the wind and keeps its height; the gust alone is left.
    assert flown.states[1, 0, 5] == pytest.approx(0.1)


def test_the_wind_field_has_its_rms_and_no_divergence() -> None:
    field = MeanWind(Scenario(wind={"field_rms": 2.0, "mean": (0.0, 0.0), "field_modes": 500}, space={"dimensions": 3}))
    at = np.random.default_rng(1).normal(size=(4000, 6)) * 300.0
    wind = field(at)
    assert np.sqrt((wind**2).sum(axis=-1).mean()) == pytest.approx(2.0, rel=0.1)
    assert (np.abs(np.sqrt((wind**2).mean(axis=0)) / (2.0 / np.sqrt(3.0)) - 1.0) < 0.15).all()
    step, divergence = 1e-4, 0.0
    for axis in range(3):
        ahead, behind = at.copy(), at.copy()
        ahead[:, axis] += step
        behind[:, axis] -= step
        divergence = divergence + (field(ahead) - field(behind))[:, axis] / (2 * step)
    np.testing.assert_allclose(divergence, 0.0, atol=1e-6)
    np.testing.assert_array_equal(field(at[7:8]), wind[7:8])


def test_the_radio_reaches_as_far_as_uavs_are_apart_in_space() -> None:
    scenario = Scenario(uavs=2, start={"positions": ((0.0, 0.0, 10.0), (3.0, 0.0, 14.0))}, space={"dimensions": 3})
    places = in_space(np.array([[0.0, 0.0, 10.0], [3.0, 0.0, 14.0]]), scenario)
    np.testing.assert_array_equal(places, [[0.0, 0.0, 10.0], [3.0, 0.0, 14.0]])


def test_columns_of_a_time_series_have_z_in_space_only() -> None:
    flown = mf.fly(Scenario(**SWAP))
    names = flown.frame().column_names
    assert names[2:11] == ["x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s", "ax_m_s2", "ay_m_s2", "az_m_s2"]
    assert flown.states.shape[2] == 6
    flat = mf.fly(Scenario(method="cruise", uavs=2, duration=1.0)).frame().column_names
    assert not {"z_m", "vz_m_s", "az_m_s2"} & set(flat)


def test_a_flight_that_is_stepped_and_an_environment_have_three_axes() -> None:
    scenario = Scenario(uavs=4, duration=5.0, start={"layers": 2}, **CALM)
    stepped = mf.Stepped(scenario)
    stepped.step(np.tile([0.0, 0.0, 2.0], (4, 1)))
    np.testing.assert_allclose(stepped.states[:, 5], 0.2)
    flights = env.parallel_env(scenario, neighbours=2)
    observed, _ = flights.reset(seed=1)
    starts = state.position(stepped.states) - [0.0, 0.0, 0.02]
    for uav, row in enumerate(observed.values()):
        assert row.shape == (6 + 2 * (6 + 2),)
        np.testing.assert_allclose(row[:6], [*starts[uav] - [0.0, 0.0, 40.0], 0.0, 0.0, 0.0], atol=1e-4)
        nearest = np.sort(np.linalg.norm(starts - starts[uav], axis=-1))[1]
        assert np.linalg.norm(row[6:9]) == pytest.approx(nearest, rel=1e-6)
    flights.step({agent: np.array([0.0, 0.0, 1.0]) for agent in flights.agents})
