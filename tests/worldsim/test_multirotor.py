"""The vehicle `multirotor`: its lag, its limits, its power, and the point mass that it is without a lag."""

import math
from typing import Any

import numpy as np
import pytest

from meanflock.kernels.quadrotor import GRAVITY
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.base import Physics
from meanflock.worldsim.vehicles.multirotor import Multirotor
from meanflock.worldsim.vehicles.quadrotor import Quadrotor

SPACE: dict[str, Any] = {"space.dimensions": 3}
CALM = {"wind.sigma": 0.0, "wind.drag": 0.0}


def vehicle_of(options: dict[str, Any], **keys: Any) -> Multirotor:
    return Multirotor(Multirotor.Options(**options), Scenario(uavs=1, **SPACE | keys))


def flown(vehicle: Any, command: tuple[float, ...], ticks: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The states (ticks + 1, 6) of one UAV from hover, and the last hidden state."""
    states, hidden, seen = np.zeros((1, 6)), vehicle.init(1), [np.zeros((1, 6))]
    for _ in range(ticks):
        states, hidden = vehicle.step(states, hidden, np.array([command]), np.zeros((1, 3)), np.zeros((1, 3)))
        seen.append(states)
    return np.concatenate(seen), hidden


def test_the_thrust_follows_by_first_order() -> None:
    vehicle = vehicle_of({"attitude_s": 0.3, "thrust_s": 0.2}, **CALM)
    states, hidden = flown(vehicle, (2.0, -1.0, 3.0), 7)
    lags = np.array([0.3, 0.3, 0.2])
    share = -np.expm1(-0.7 / lags)
    np.testing.assert_allclose(hidden["thrust"][0], np.array([2.0, -1.0, 3.0]) * share + [0, 0, GRAVITY], rtol=1e-12)
    np.testing.assert_allclose(states[-1, 3:], np.array([2.0, -1.0, 3.0]) * (0.7 - lags * share), rtol=1e-12)


def test_without_lags_it_is_the_point_mass() -> None:
    keys: dict[str, Any] = {**SPACE, "uavs": 3, "start.centre": (50.0, 0.0), "wind.mean": (1.0, 0.0, 0.5)}
    quick = {"attitude_s": 1e-9, "thrust_s": 1e-9}
    flights = [
        Flight(Scenario(**keys, **{"vehicle.model": "point-mass"})),
        Flight(Scenario(**keys, **{"vehicle.model": "multirotor", "vehicle.options": quick})),
    ]
    commands = np.random.default_rng(2).normal(size=(30, 3, 3))
    gust = np.array([0.3, 0.0, -0.2]) * np.ones((3, 1))
    for flight in flights:
        for command in commands:
            flight.advance(command, gust)
    np.testing.assert_allclose(flights[1].states, flights[0].states, atol=1e-6)


def test_its_step_is_near_that_of_the_quadrotor() -> None:
    rigid = Quadrotor(Quadrotor.Options(), Scenario(uavs=1, **SPACE | CALM))
    one, _ = flown(rigid, (2.0, 1.0, 1.0), 20)
    other, _ = flown(vehicle_of({}, **CALM), (2.0, 1.0, 1.0), 20)
    np.testing.assert_allclose(other[-1, 3:], one[-1, 3:], rtol=0.01)


def test_thrust_has_a_limit_and_never_pulls_down() -> None:
    vehicle = vehicle_of({"thrust_max_N": 10.0}, **CALM)
    _, hidden = flown(vehicle, (30.0, 0.0, 0.0), 20)
    assert vehicle.shown(hidden)[0, 3] == pytest.approx(10.0)
    states, hidden = flown(vehicle, (0.0, 0.0, -30.0), 20)
    np.testing.assert_allclose(hidden["thrust"], 0.0, atol=1e-9)
    np.testing.assert_allclose(states[-1, 5] - states[-2, 5], -GRAVITY * 0.1, rtol=1e-9)
    with pytest.raises(BadInput, match=r"`thrust_max_N` = 4 does not lift `mass_kg`, which weighs 4\.91 N"):
        vehicle_of({"thrust_max_N": 4.0})


def test_power_is_that_of_momentum_theory() -> None:
    vehicle = vehicle_of({"disc_m2": 0.2, "figure_of_merit": 0.5})
    weight = 0.5 * GRAVITY
    expected = weight**1.5 / math.sqrt(2.0 * 1.225 * 0.2) / 0.5
    np.testing.assert_allclose(vehicle.power(np.zeros((1, 6)), vehicle.init(1), np.zeros((1, 3))), expected, rtol=1e-12)


def test_angles_are_those_that_turn_the_vertical_to_the_thrust() -> None:
    vehicle = vehicle_of({})
    thrust = np.random.default_rng(1).normal((0.0, 0.0, 5.0), 1.0, (20, 3))
    roll, pitch, yaw, _ = vehicle.shown({"thrust": thrust}).T
    turned = np.stack([np.sin(pitch) * np.cos(roll), -np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=-1)
    np.testing.assert_allclose(turned, thrust / np.linalg.norm(thrust, axis=1, keepdims=True), atol=1e-12)
    assert (yaw == 0.0).all()


@pytest.mark.parametrize("name", ["quadrotor", "multirotor"])
def test_a_uav_at_rest_hovers(name: str) -> None:
    physics = Physics(Scenario(uavs=2, **SPACE | {"vehicle.model": name}))
    vehicle, hidden = physics._vehicle, physics.init()
    for array in hidden.values():
        array += 1.0
    for one, other in zip(vehicle.rest(hidden).values(), vehicle.init(2).values(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert plugins.load("vehicle", name).columns == ("roll_rad", "pitch_rad", "yaw_rad", "thrust_N")
