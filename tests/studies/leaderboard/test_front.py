"""The front is a bound that no flight can beat, and that good flights come close to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from meanflock.studies.leaderboard.front import Front, envelope, front, power
from meanflock.studies.leaderboard.regret import Fronts
from meanflock.swarm.scenario import Scenario

PAPER = Scenario()
WAY = np.array([-150.0, -100.0])


@pytest.fixture(scope="module")
def least() -> Front:
    return front(PAPER, WAY)


def trapezoid(way_m: float, cruise: float, rise: float = 1.0, brake: float = 0.5) -> tuple[float, float]:
    """Time and energy of a flight that speeds up, cruises and brakes to rest, by small steps."""
    ramps = cruise / rise, cruise / brake
    steady = (way_m - cruise * sum(ramps) / 2) / cruise
    time = sum(ramps) + steady
    t = (np.arange(200_000) + 0.5) / 200_000 * time
    speed = np.minimum.reduce([rise * t, np.full_like(t, cruise), brake * (time - t)])
    return time, float(power(PAPER, speed).mean() * time)


def test_an_envelope_of_a_convex_rising_function_is_the_function() -> None:
    x = np.linspace(0.0, 3.0, 301)
    at, y = envelope(x, x**2 + 1.0)
    np.testing.assert_allclose(np.interp(x, at, y), x**2 + 1.0)


def test_an_envelope_bridges_what_bulges_and_is_flat_below_the_minimum() -> None:
    """|x² − 1| has its least, 0, at 1: slower on average is had for nothing by flying to and fro."""
    x = np.linspace(0.0, 3.0, 3001)
    at, y = envelope(x, np.abs(x**2 - 1.0))
    below = np.interp(x, at, y)
    np.testing.assert_allclose(below[x <= 1.0], 0.0, atol=1e-12)
    np.testing.assert_allclose(below[x >= 1.0], x[x >= 1.0] ** 2 - 1.0, atol=1e-12)
    bump = np.minimum(x**2, 4.0 + (x - 2.0) / 10.0)  # of two pieces: the line that touches both is below their corner
    at, y = envelope(x, bump)
    slope = np.diff(y) / np.diff(at)
    assert (np.diff(slope) > -1e-9).all()
    assert (np.interp(x, at, y) <= bump + 1e-12).all()
    assert np.interp(2.0, at, y) < 3.0


def test_the_least_energy_of_all_is_that_of_the_speed_of_least_energy_a_metre(least: Front) -> None:
    speeds = np.linspace(0.5, 10.0, 100_000)
    a_metre = power(PAPER, speeds) / speeds
    way = np.hypot(*WAY) - PAPER.destination.radius
    assert least.energies_J[-1] == pytest.approx(way * a_metre.min(), rel=1e-5)
    assert least.least_J(way / speeds[a_metre.argmin()]) == pytest.approx(least.energies_J[-1], rel=1e-4)
    assert least.least_J(1e6) == least.energies_J[-1]


@pytest.mark.parametrize("time_s", [30.0, 46.0, 60.0, 75.0])
def test_no_speed_profile_that_an_optimiser_finds_is_cheaper(least: Front, time_s: float) -> None:
    """Sixteen speeds of equal length that cover the way, free of any limit of acceleration: the best that SLSQP finds
    from several starts is the front, and nothing is below it."""
    way, pieces = float(np.hypot(*WAY)) - PAPER.destination.radius, 16

    def energy(speeds: np.ndarray) -> float:
        return float(power(PAPER, np.abs(speeds)).mean() * time_s)

    found = []
    for seed in range(4):
        start = np.random.default_rng(seed).uniform(0.2, 2.0, pieces)
        start *= way / time_s / start.mean()
        covers = {"type": "eq", "fun": lambda speeds: speeds.mean() - way / time_s}
        done = minimize(energy, start, method="SLSQP", constraints=[covers], bounds=[(0.0, 30.0)] * pieces)
        assert done.success
        found.append(done.fun)
    assert min(found) >= (1 - 5e-5) * least.least_J(time_s)
    assert min(found) == pytest.approx(least.least_J(time_s), rel=2e-3)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(0.05, 12.0), min_size=1, max_size=30), st.floats(0.0, 2 * np.pi))
def test_no_flight_is_below_the_front_whatever_its_speeds(speeds: list[float], heading: float) -> None:
    """Ticks of arbitrary speeds along a line that ends at the edge of the destination."""
    flown = np.array(speeds)
    ticks = 40
    time = len(flown) * ticks * PAPER.dt
    way = float(flown.sum()) * ticks * PAPER.dt + PAPER.destination.radius
    energy = float(power(PAPER, flown).sum()) * ticks * PAPER.dt
    there = front(PAPER, way * np.array([np.cos(heading), np.sin(heading)]))
    assert energy >= (1 - 5e-5) * there.least_J(time)


@pytest.mark.parametrize(
    ("cruise", "time_s", "energy_J"), [(5.0, 37.0, 21.8), (4.0, 46.0, 14.8), (3.05, 60.0, 10.4), (2.25, 80.0, 9.05)]
)
def test_flights_that_accelerate_as_craft_do_come_near_the_front(
    least: Front, cruise: float, time_s: float, energy_J: float
) -> None:
    """To within the destination's radius at cruise; energies as a simulation of the whole world measured them."""
    way = float(np.hypot(*WAY)) - PAPER.destination.radius
    time, energy = trapezoid(way, cruise, rise=1.0, brake=50.0)
    assert time == pytest.approx(time_s, rel=0.04)
    assert energy == pytest.approx(energy_J, rel=0.05)
    assert least.least_J(time) < energy < 1.12 * least.least_J(time)


def test_the_front_falls_and_is_convex(least: Front) -> None:
    assert (np.diff(least.energies_J) <= 0.0).all()
    slope = np.diff(least.energies_J) / np.diff(least.times_s)
    assert (np.diff(slope) > -1e-6).all()


def test_by_airspeed_a_tail_wind_carries_and_a_head_wind_costs() -> None:
    """Faster than is cheapest, all of the time is used, at the airspeed v − w: 95 m in 20 s, 1.5 m/s of it given."""
    way, time = np.array([100.0, 0.0]), 20.0
    still, tail, head = (front(PAPER, way, np.array([x, 0.0])) for x in (0.0, 1.5, -1.5))
    np.testing.assert_allclose(still.energies_J, front(PAPER, way).energies_J)
    for there, airspeed in ((tail, 95 / time - 1.5), (still, 95 / time), (head, 95 / time + 1.5)):
        assert there.least_J(time) == pytest.approx(time * power(PAPER, np.array([airspeed]))[0], rel=1e-4)


def test_a_cross_wind_is_flown_against_at_its_own_speed() -> None:
    """Between the tips of two velocities at a right angle: √(v² + w²); the destination's edge gives what it can."""
    there = front(PAPER, np.array([100.0, 0.0]), np.array([0.0, 3.0]))
    airspeed = np.hypot(100 / 20.0, 3.0) - PAPER.destination.radius / 20.0
    assert there.least_J(20.0) == pytest.approx(20.0 * power(PAPER, np.array([airspeed]))[0], rel=1e-4)


def test_a_flight_that_ended_on_the_way_has_no_regret_for_being_cheap() -> None:
    fronts = Fronts(Scenario(uavs=2))
    least = [each.least_J(PAPER.duration) for each in fronts.each or ()]
    flown = {"lost": 0, "travel_s": [None, None], "energy_J": [least[0] + 1.0, least[1] + 3.0]}
    assert fronts.regret(flown) == pytest.approx(2.0)
    assert fronts.regret(flown | {"energy_J": [least[0] + 1.0, least[1] - 0.1]}) is None
