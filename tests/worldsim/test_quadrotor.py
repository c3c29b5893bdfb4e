"""The vehicle `quadrotor`: closed forms, the linearised model, limits, bad input, rest, and the ground."""

import math
from typing import Any

import numpy as np
import pytest

from meanflock.kernels.quadrotor import ATTITUDE, GRAVITY, POWER, RATES
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.stateful import restore, state_of
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.base import Physics
from meanflock.worldsim.vehicles.quadrotor import Quadrotor

QUADROTOR = {"space.dimensions": 3, "vehicle.model": "quadrotor"}
CALM: dict[str, Any] = {**QUADROTOR, "wind.sigma": 0.0, "wind.drag": 0.0}
CRAZYFLIE = {  # RotorPy's constants
    **{"mass_kg": 0.03, "inertia_kg_m2": [1.43e-5, 1.43e-5, 2.89e-5], "arm_m": 0.043, "k_eta": 2.3e-8, "k_m": 7.8e-10},
    **{"tau_s": 0.072, "speed_max_rad_s": 2500.0, "k_p": 1030.0, "k_d": 51.0},
}


def flown(
    command: tuple[float, ...], ticks: int, push: tuple[float, ...] = (0.0, 0.0, 0.0), **keys: Any
) -> tuple[np.ndarray, np.ndarray, Quadrotor]:
    """States and bodies (ticks + 1, …) of one UAV that begins in hover, and the vehicle."""
    options = keys.pop("options", {})
    vehicle = Quadrotor(Quadrotor.Options(**options), Scenario(uavs=1, **CALM | keys))
    states, hidden = np.zeros((1, 6)), vehicle.init(1)
    seen, bodies = [states], [hidden["body"]]
    for _ in range(ticks):
        states, hidden = vehicle.step(states, hidden, np.array([command]), np.zeros((1, 3)), np.array([push]))
        seen.append(states)
        bodies.append(hidden["body"])
    return np.concatenate(seen), np.concatenate(bodies), vehicle


def test_hover_stays_and_costs_the_power_of_its_rotors() -> None:
    states, bodies, vehicle = flown((0.0, 0.0, 0.0), 100)
    np.testing.assert_allclose(states, 0.0, atol=1e-10)
    np.testing.assert_allclose(bodies[-1, :7], [1, 0, 0, 0, 0, 0, 0], atol=1e-12)
    expected = 4.0 * 1.36e-7 * (0.5 * GRAVITY / (4.0 * 5.57e-6)) ** 1.5
    power = vehicle.power(states[-1:], {"body": bodies[-1:]}, np.zeros((1, 3)))
    np.testing.assert_allclose(power, expected, rtol=1e-12)
    shown = vehicle.shown({"body": bodies[-1:]})
    np.testing.assert_allclose(shown, [[0.0, 0.0, 0.0, 0.5 * GRAVITY]], atol=1e-10)


@pytest.mark.parametrize("down", [-GRAVITY, -50.0])
def test_without_thrust_it_falls_as_soon_as_the_rotors_have_slowed_down_and_stays_level(down: float) -> None:
    states, bodies, _ = flown((0.0, 0.0, down), 10)
    # Rotor speeds decay as exp(−t/τ), so thrust does as exp(−2t/τ), in steps of 2 ms.
    left = 0.002 * GRAVITY / math.tanh(0.002 / 0.005) / 2
    np.testing.assert_allclose(states[-1, 5], -GRAVITY * 1.0 + left, rtol=1e-12)
    np.testing.assert_allclose(states[-1, 2], -GRAVITY / 2 + left, atol=left * 0.01)
    np.testing.assert_allclose(bodies[-1, ATTITUDE], [1, 0, 0, 0], atol=1e-12)


def test_a_small_step_is_that_of_the_linearised_model_in_the_limit_of_small_steps() -> None:
    """φ'' = u and τ u' = −k_p (φ − φ*) − k_d φ' − u, φ* = a/g."""
    wanted, tau, k_p, k_d = 0.02, 0.005, 544.0, 46.64
    rates, vectors = np.linalg.eig(np.array([[0, 1, 0], [0, 0, 1], [-k_p / tau, -k_d / tau, -1 / tau]]))
    begin = np.linalg.solve(vectors, [-wanted / GRAVITY, 0.0, 0.0])
    times = 0.02 * np.arange(31)
    exact = wanted / GRAVITY + (vectors[0] * np.exp(times[:, None] * rates)) @ begin
    errors = []
    for rate in (1000.0, 2000.0, 4000.0):
        _, bodies, vehicle = flown((wanted, 0.0, 0.0), 30, dt=0.02, options={"rate_hz": rate})
        pitch = vehicle.shown({"body": bodies})[:, 1]
        errors.append(np.abs(pitch - exact.real).max() * GRAVITY / wanted)
    assert errors[0] < 0.02
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 1.0, atol=0.1)


@pytest.mark.parametrize("command", [(3.0, 0.0, 0.0), (0.0, -4.0, 2.0), (-6.0, 5.0, -3.0)])
def test_the_commanded_acceleration_is_reached_and_the_heading_kept(command: tuple[float, ...]) -> None:
    states, bodies, vehicle = flown(command, 20)
    reached = (states[-1, 3:] - states[-2, 3:]) / 0.1
    np.testing.assert_allclose(reached, command, atol=1e-6)
    roll, pitch, yaw, thrust = vehicle.shown({"body": bodies[-1:]})[0]
    assert (np.sign(np.round([roll, pitch], 9)) == np.sign([-command[1], command[0]])).all()
    assert (abs(yaw) < 1e-9) == (0.0 in command[:2])  # 0 unless it tilts about both axes
    w, x, y, z = bodies[-1, ATTITUDE]
    forward = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)]
    up = np.array(command)
    up[2] += GRAVITY
    nearest = np.eye(3)[0] - up * (up[0] / (up @ up))  # direction at right angles to the thrust nearest to x
    np.testing.assert_allclose(forward, nearest / np.linalg.norm(nearest), atol=1e-6)
    assert thrust == pytest.approx(0.5 * math.hypot(command[0], command[1], command[2] + GRAVITY), rel=1e-6)
    np.testing.assert_allclose(bodies[-1, RATES], 0.0, atol=1e-6)


def test_a_gust_pushes_and_is_not_tracked() -> None:
    states, bodies, _ = flown((0.0, 0.0, 0.0), 10, push=(1.0, 0.0, -2.0))
    np.testing.assert_allclose(states[-1], [0.5, 0, -1.0, 1.0, 0, -2.0], atol=1e-10)
    np.testing.assert_allclose(bodies[-1, ATTITUDE], [1, 0, 0, 0], atol=1e-12)


def test_drag_draws_it_along_with_the_mean_wind() -> None:
    states, _, _ = flown((0.0, 0.0, 0.0), 50, **{"wind.drag": 0.5, "wind.mean": (2.0, 0.0, 1.0)})
    np.testing.assert_allclose(states[-1, 3:], np.array([2.0, 0.0, 1.0]) * -math.expm1(-0.5 * 5.0), rtol=1e-3)


def test_a_flight_gives_it_command_and_gust_apart() -> None:
    gust = [{"kind": "gust", "tick": 0, "duration_s": 1.0, "acceleration": [1.0, 0.0, 0.0]}]
    flight = Flight(Scenario(uavs=1, faults=gust, start={"positions": [(50.0, 0.0, 30.0)]}, **CALM))
    for _ in range(10):
        flight.advance(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(state.velocity(flight.states)[0], [1.0, 0.0, 0.0], atol=1e-10)
    assert flight.effort[0] == 0.0
    np.testing.assert_allclose(flight.shown()[0, :3], 0.0, atol=1e-12)


def bad(expected: str, options: dict[str, Any], **keys: Any) -> None:
    with pytest.raises(BadInput, match=expected):
        Physics(Scenario(uavs=1, **QUADROTOR | {"vehicle.options": options} | keys))


def test_gains_that_cannot_be_stable_are_refused_with_the_bound() -> None:
    bad(r"`k_d` = 51 .*Routh.*k_d > tau_s · k_p = 74.16 1/s; raise `k_d`, or lower", CRAZYFLIE)
    Physics(Scenario(uavs=1, **QUADROTOR | {"vehicle.options": CRAZYFLIE | {"k_p": 150.0, "k_d": 30.0}}))


def test_steps_that_are_too_long_are_refused_with_the_rate_that_is_needed() -> None:
    bad(r"steps of 50 ms is unstable; .*at most (\S+) ms: raise `rate_hz` to \d+ or more", {"rate_hz": 20})
    with pytest.raises(BadInput, match="raise `rate_hz` to") as caught:
        Physics(Scenario(uavs=1, **QUADROTOR | {"vehicle.options": {"rate_hz": 20}}))
    enough = int(str(caught.value).partition("`rate_hz` to ")[2].split()[0])
    states, _, _ = flown((0.5, 0.0, 0.0), 100, options={"rate_hz": enough})
    np.testing.assert_allclose((states[-1, 3] - states[-2, 3]) / 0.1, 0.5, atol=0.05)
    bad("is unstable", {"rate_hz": enough - 10})
    bad("no `rate_hz` up to 100000 is enough for its gains: lower `k_d`", {"k_d": 1e12})


def test_a_craft_that_does_not_lift_its_weight_and_options_out_of_bounds_are_refused() -> None:
    bad(r"lift 50.1 N, and `mass_kg` weighs 98.1 N", {"mass_kg": 10.0})
    bad(r"inertia_kg_m2.*> 0", {"inertia_kg_m2": [0.1, 0.1, 0.0]})
    bad(r"rate_hz.*> 0", {"rate_hz": 0})
    bad("flies in 3 dimensions, and `space.dimensions` is 2", {}, **{"space.dimensions": 2})


def test_a_uav_that_left_every_bound_hovers() -> None:
    scenario = Scenario(uavs=2, **CALM)
    physics = Physics(scenario)
    states = np.array([[9.9e8, 0.0, 50.0, 9.9e8, 0.0, 0.0], [0.0, 0.0, 50.0, 0.0, 0.0, 0.0]])
    hidden = physics.init()
    hidden["body"][:, RATES] = 3.0
    moved = physics.step(states, hidden, np.zeros((2, 3)), np.zeros((2, 3)), None)
    assert moved.diverged.tolist() == [0]
    np.testing.assert_array_equal(moved.hidden["body"][0, :7], [1, 0, 0, 0, 0, 0, 0])
    assert (moved.hidden["body"][1, RATES] != 0.0).all()


@pytest.mark.parametrize(
    ("column", "number", "expected"),
    [(0, 1.1, "no unit quaternion"), (2, np.nan, "no unit"), (5, np.nan, "not finite")],
)
def test_a_checkpoint_with_an_impossible_body_ends_the_run(column: int, number: float, expected: str) -> None:
    flight = Flight(Scenario(uavs=2, **CALM))
    stored = state_of(flight)
    stored["hidden"] = {"body": stored["hidden"]["body"].copy()}
    stored["hidden"]["body"][1, column] = number
    restore(flight, stored)
    with pytest.raises(RunFailed, match=f"(?s)vehicle 'quadrotor': .*1.*{expected}"):
        flight.advance(np.zeros((2, 3)))


def test_it_takes_off_from_the_ground_and_lands_on_it() -> None:
    flight = Flight(Scenario(uavs=1, start={"positions": [(50.0, 0.0, 0.0)]}, **CALM))
    heights = []
    for command in (
        *[(0.0, 0.0, -1.0)] * 5,
        *[(0.5, 0.0, 1.0)] * 10,
        *[(-0.5, 0.0, -1.0)] * 30,
        *[(0.0, 0.0, 1.0)] * 10,
    ):
        flight.advance(np.array([command]))
        heights.append(float(flight.states[0, 2]))
    assert heights[4] == 0.0
    assert max(heights[:15]) == pytest.approx(0.5, abs=0.02)
    assert heights[44] == 0.0
    assert heights[-1] == pytest.approx(0.5, abs=0.02)
    assert flight.hidden["body"][0, POWER] > 0.0
    np.testing.assert_allclose(flight.shown()[0, :3], 0.0, atol=1e-3)
