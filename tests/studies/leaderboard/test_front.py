"""The front: a lower bound of the energy of every flight."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.studies.leaderboard.front import Fronts, envelope, front, power
from meanflock.swarm.scenario import Scenario

PAPER = Scenario()


def test_an_envelope_is_convex_and_never_above_its_function() -> None:
    """A rising convex function is its own envelope; between two convex pieces it is the line that touches both."""
    x = np.linspace(0.0, 3.0, 3001)
    bump = np.minimum(x**2, 4.0 + (x - 2.0) / 10.0)
    for function in (x**2 + 1.0, bump):
        at, y = envelope(x, function)
        below = np.interp(x, at, y)
        assert (np.diff(np.diff(y) / np.diff(at)) > -1e-9).all()
        assert (below <= function + 1e-12).all()
        assert function is bump or below == pytest.approx(function, abs=1e-12)
    assert np.interp(2.0, at, y) < 3.0


@settings(max_examples=60, deadline=None)
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
    ("wind", "airspeed"),
    [((0.0, 0.0), 4.75), ((1.5, 0.0), 3.25), ((-1.5, 0.0), 6.25), ((0.0, 3.0), np.hypot(5.0, 3.0) - 0.25)],
    ids=["calm", "tail", "head", "cross"],
)
def test_the_front_depends_on_the_wind(wind: tuple[float, float], airspeed: float) -> None:
    """100 m in 20 s, 5 m of them inside the destination. A cross wind is flown against at √(v² + w²)."""
    there = front(PAPER, np.array([100.0, 0.0]), np.array(wind))
    assert there.least_J(20.0) == pytest.approx(20.0 * power(PAPER, np.array([airspeed]))[0], rel=1e-4)


def test_a_flight_that_ended_on_the_way_has_no_regret_for_being_cheap() -> None:
    fronts = Fronts(Scenario(uavs=2))
    least = [each.least_J(PAPER.duration) for each in fronts.each or ()]
    flown = {"lost": 0, "travel_s": [None, None], "energy_J": [least[0] + 1.0, least[1] + 3.0]}
    assert fronts.regret(flown) == pytest.approx(2.0)
    assert fronts.regret(flown | {"energy_J": [least[0] + 1.0, least[1] - 0.1]}) is None
