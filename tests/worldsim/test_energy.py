"""What motion costs."""

import json
from pathlib import Path

import numpy as np
import pytest

from meanflock.swarm import state
from meanflock.swarm.scenario import load
from meanflock.worldsim.vehicles.point_mass import PointMass

ORACLE = json.loads((Path(__file__).parents[1] / "oracle" / "power.json").read_text())
VEHICLE = load(None).vehicle


def power(speeds: np.ndarray) -> np.ndarray:
    """P(‖v‖) in W."""
    states = np.zeros((*speeds.shape, state.SIZE))
    states[..., state.VX] = speeds
    return PointMass(PointMass.Options(), load(None)).power(states, {}, np.zeros(2))


def test_power_is_the_oracle_s() -> None:
    speeds = np.array([case["speed_m_s"] for case in ORACLE], dtype=float)
    expected = [case["power_W"] for case in ORACLE]
    np.testing.assert_allclose(power(speeds), expected, rtol=1e-9)


def test_hovering_costs_blade_and_induced_power_only() -> None:
    assert power(np.zeros(1)) == pytest.approx([VEHICLE.blade_power + VEHICLE.induced_power], rel=1e-12)


def test_the_form_without_cancellation_is_the_printed_one_where_that_still_holds_digits() -> None:
    speeds = np.linspace(0.0, 12.0, 50)
    u = speeds**2 / (2 * VEHICLE.induced_velocity**2)
    printed = (
        VEHICLE.blade_power * (1 + 3 * speeds**2 / VEHICLE.tip_speed**2)
        + VEHICLE.induced_power * np.sqrt(np.sqrt(1 + u**2) - u)
        + VEHICLE.parasite_drag * speeds**3 / 2
    )
    np.testing.assert_allclose(power(speeds), printed, rtol=1e-9)


def test_even_at_absurd_speed_power_is_finite_and_positive() -> None:
    watts = power(np.logspace(-12, 9, 100))
    assert np.isfinite(watts).all()
    assert (watts > 0).all()


def test_slow_flight_is_cheaper_than_hovering_and_fast_flight_dearer() -> None:
    watts = power(np.array([0.0, 1.0, 5.0]))
    assert watts[1] < watts[0] < watts[2]


def test_power_has_the_shape_of_the_speeds() -> None:
    speeds = np.random.default_rng(1).random((3, 4)) * 10
    watts = power(speeds)
    assert watts.shape == (3, 4)
    assert watts[1, 2] == power(speeds[1, 2:3])[0]
