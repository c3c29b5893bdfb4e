"""Buffered Voronoi cells: a UAV stays in its cell, and can always stop in it."""

import numpy as np
import pytest

from meanflock.agent.controllers.sharing.bvc import BufferedVoronoi
from meanflock.agent.controllers.sharing.nearby import stopping_slope, stopping_speed
from meanflock.swarm.scenario import load


@pytest.mark.parametrize(("deceleration", "delay"), [(2.0, 0.1), (6.0, 0.35), (0.5, 1.0)])
def test_the_stopping_speed_solves_its_equation_and_its_slope_is_the_derivative(
    deceleration: float, delay: float
) -> None:
    distance = np.linspace(0.01, 20.0, 200)
    speed = stopping_speed(distance, deceleration, delay)
    np.testing.assert_allclose(speed * delay + speed**2 / (2.0 * deceleration), distance, rtol=1e-12)
    quotient = np.gradient(stopping_speed(distance, deceleration, delay), distance)
    np.testing.assert_allclose(stopping_slope(distance, deceleration, delay)[5:-1], quotient[5:-1], rtol=0.02)
    inside = np.array([-0.5, 0.0])
    np.testing.assert_allclose(stopping_speed(inside, deceleration, delay), inside / delay)
    np.testing.assert_allclose(stopping_slope(inside, deceleration, delay), 1.0 / delay)
    assert stopping_speed(np.array([0.0, 1.0, 9.0]), 0.0, delay).tolist() == [0.0, 0.0, 0.0]  # without a brake
    assert stopping_slope(np.array([-1.0, 1.0]), 0.0, delay).tolist() == [1.0 / delay, 0.0]


@pytest.mark.parametrize("speed", [2.25, 4.0])
def test_two_uavs_head_on_stop_in_their_cells(speed: float) -> None:
    scenario = load(None, ["uavs=2", "wind.sigma=0", "wind.drag=0", "vehicle.acceleration_max=3"])
    options = BufferedVoronoi.Options(radius_m=0.5, right_bias=0.0, velocity_gain_1_s=4.0, speed_m_s=speed)
    controller = BufferedVoronoi(options, scenario)
    own = np.array([[10.0, 0.0, speed, 0.0], [30.0, 0.0, -speed, 0.0]])
    memory = controller.init(np.arange(2), own) | {"travel_end": np.array([[40.0, 0.0], [0.0, 0.0]])}
    for _ in range(150):
        everyone = np.repeat(own[None], 2, axis=0)
        acceleration = controller.fly(memory, own, everyone).acceleration
        assert (np.linalg.norm(acceleration, axis=1) <= 3.0 + 1e-9).all()
        own = np.concatenate([own[:, :2] + 0.1 * own[:, 2:], own[:, 2:] + 0.1 * acceleration], axis=1)
        assert own[0, 0] < 20.0 - 0.35  # the lag of the velocity carries it up to 11 cm beyond
    assert own[1, 0] - own[0, 0] == pytest.approx(1.0, abs=0.1)
