"""Power of a climbing and sinking rotor: closed forms, the printed formula, continuity, and cases by hand."""

import numpy as np
import pytest

import meanflock as mf
from meanflock.studies.leaderboard.front import Fronts
from meanflock.swarm.scenario import Scenario, VehicleTable
from meanflock.worldsim.vehicles import rotor
from meanflock.worldsim.vehicles.point_mass import PointMass

CRAFT = VehicleTable()
V0 = CRAFT.induced_velocity
WEIGHT_N = CRAFT.induced_power / V0
SPACE = {"space.dimensions": 3, "wind.sigma": 0.0}


def watts(level: np.ndarray | float, climb: np.ndarray | float) -> np.ndarray:
    level, climb = np.broadcast_arrays(np.asarray(level, dtype=float), np.asarray(climb, dtype=float))
    return rotor.power(CRAFT, level, climb, np.hypot(level, climb))


@pytest.mark.parametrize(
    ("level", "climb", "expected_W"),
    [(0.0, 0.0, 0.094), (0.0, 1.0, 0.130), (2.25, 0.0, 0.115), (2.25, 1.0, 0.178), (2.25, -0.5, 0.095)],
)
def test_the_paper_s_craft(level: float, climb: float, expected_W: float) -> None:
    assert watts(level, climb) == pytest.approx(expected_W, abs=5e-4)


def test_a_vertical_climb_has_its_closed_form() -> None:
    climb = np.linspace(0.01, 60.0, 500)
    induced = WEIGHT_N * (0.5 * climb + np.sqrt(0.25 * climb * climb + V0 * V0))
    np.testing.assert_allclose(watts(0.0, climb), CRAFT.blade_power + induced + CRAFT.parasite_drag * climb**3 / 2)


def test_a_windmill_has_its_closed_form_and_gains_nothing() -> None:
    climb = np.linspace(-3.4, -3.9, 50)
    induced = WEIGHT_N * (0.5 * climb - np.sqrt(0.25 * climb * climb - V0 * V0))
    total = CRAFT.blade_power + induced - CRAFT.parasite_drag * climb**3 / 2
    np.testing.assert_allclose(watts(0.0, climb), np.maximum(total, CRAFT.blade_power))
    assert (total < CRAFT.blade_power + CRAFT.parasite_drag * -(climb**3) / 2).all()


@pytest.mark.parametrize("climb", [-8.0, -3.0, -1.0, -0.1, 0.1, 1.0, 8.0])
def test_forward_flight_satisfies_momentum_theory(climb: float) -> None:
    level = np.linspace(V0, 20.0, 300)
    own = (
        CRAFT.blade_power * (1 + 3 * level**2 / CRAFT.tip_speed**2)
        + CRAFT.parasite_drag * (level**2 + climb**2) ** 1.5 / 2
    )
    power = watts(level, climb)
    above_floor = power > CRAFT.blade_power
    through = (power - own)[above_floor] / WEIGHT_N
    residual = (through - climb) * np.sqrt(level[above_floor] ** 2 + through**2)
    np.testing.assert_allclose(residual, V0 * V0, rtol=1e-6)


def test_level_flight_is_the_printed_formula_to_the_bit() -> None:
    speeds = np.linspace(0.0, 12.0, 999)
    heading = np.linspace(0.0, 6.0, 999)
    flat = np.zeros((999, 4))
    flat[:, 2], flat[:, 3] = speeds * np.cos(heading), speeds * np.sin(heading)
    space = np.zeros((999, 6))
    space[:, 3:5] = flat[:, 2:]
    space[::2, 5] = 0.3
    in_plane = PointMass(PointMass.Options(), Scenario()).power(flat, {}, np.zeros((999, 2)))
    in_space = PointMass(PointMass.Options(), Scenario(**SPACE)).power(space, {}, np.zeros((999, 3)))
    np.testing.assert_array_equal(in_space[1::2], in_plane[1::2])
    assert (in_space[::2] > in_plane[::2]).all()


def test_the_power_is_continuous_and_never_below_the_floor() -> None:
    level, climb = np.meshgrid(np.linspace(0.0, 4.0, 161), np.linspace(-6.0, 6.0, 24001))
    power = watts(level, climb)
    assert (power >= CRAFT.blade_power).all()
    assert np.abs(np.diff(power, axis=0)).max() < 1e-3  # steps of 0.5 mm/s
    edge = np.linspace(-6.0, 6.0, 101)
    np.testing.assert_allclose(watts(V0 - 1e-9, edge), watts(V0 + 1e-9, edge), atol=1e-8)
    wide = np.linspace(0.0, 4.0, 101)
    for climb in (-1e-9, 1e-9):
        np.testing.assert_allclose(watts(wide, climb), CRAFT.power(wide * wide, wide), atol=1e-7)


def test_extreme_speeds_have_a_finite_power() -> None:
    far = np.array([0.0, 1e-300, 1e9])
    for level in far:
        assert np.isfinite(watts(level, np.concatenate([far, -far]))).all()


def test_rising_air_saves_power_by_airspeed() -> None:
    hover = {"method": "cruise", "uavs": 1, "duration": 1.0, "wind.drag": 0.0, "stop": "duration", **SPACE}
    at = {"start": {"positions": ((0.0, 0.0),)}, "vehicle.power_speed": "air"}
    still = mf.fly(Scenario(**hover, **at, **{"wind.mean": (0.0, 0.0)})).summary["energy_end_mean_J"]
    rising = mf.fly(Scenario(**hover, **at, **{"wind.mean": (0.0, 0.0, 0.5)})).summary["energy_end_mean_J"]
    sinking = mf.fly(Scenario(**hover, **at, **{"wind.mean": (0.0, 0.0, -0.5)})).summary["energy_end_mean_J"]
    assert rising == pytest.approx(watts(0.0, -0.5).item())
    assert sinking == pytest.approx(watts(0.0, 0.5).item())
    assert sinking > still


def test_flights_in_space_have_no_energy_front() -> None:
    fronts = Fronts(Scenario(uavs=2, **SPACE))
    assert fronts.each is None
    assert fronts.regret({"lost": 0}) is None
    assert fronts.mean(np.array([10.0])) is None
