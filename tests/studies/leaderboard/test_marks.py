"""Marks and fronts: tests against closed forms, and a lower bound of the energy of every flight."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from meanflock.studies.leaderboard import marks
from meanflock.studies.leaderboard.front import Fronts, envelope, front, power
from meanflock.studies.leaderboard.measures import BY_KEY
from meanflock.swarm.scenario import Scenario

TIME, FREE, CLOSEST = BY_KEY["time_s"], BY_KEY["free"], BY_KEY["closest_m"]


def test_holm_steps_down_and_stops_at_the_first_that_is_not_rejected() -> None:
    """Holm 1979: .01 ≤ .05/4, .015 ≤ .05/3, .03 > .05/2, so .04 is not even looked at, though .04 ≤ .05."""
    assert marks.holm([0.03, 0.01, 0.04, 0.015]) == [False, True, False, True]
    assert marks.holm([]) == []
    assert marks.holm([0.05]) == [True]
    assert marks.holm([float("nan"), 0.001]) == [False, True]


def test_pairs_by_seed_are_judged_by_student_or_by_their_sign() -> None:
    rng = np.random.default_rng(1)
    common = rng.normal(size=20)
    first, second = common + 0.1 * rng.normal(size=20), common + 0.1 + 0.1 * rng.normal(size=20)
    assert marks.paired(first, second) == pytest.approx(stats.ttest_rel(first, second).pvalue)
    assert marks.paired(first, second) < 0.05 < stats.ttest_ind(first, second).pvalue
    assert marks.paired(np.zeros(30), np.ones(30)) == pytest.approx(2.0**-29)  # the difference never varies
    assert marks.paired([1.0, 2.0], [2.0, 3.0]) == 0.5
    assert marks.paired([1.0, 1.0], [1.0, 1.0]) == marks.paired([1.0], [2.0]) == 1.0


def test_yes_and_no_by_mcnemar() -> None:
    """Eight flights only the first was free in and one only the second: 2·(1 + 9)/2⁹."""
    first = [True] * 8 + [False] + [True] * 5
    second = [False] * 8 + [True] + [True] * 5
    assert marks.mcnemar(first, second) == pytest.approx(20 / 512)
    assert marks.mcnemar(first, first) == 1.0


def rows(rng: np.random.Generator, *means: float) -> dict[str, np.ndarray]:
    common = rng.normal(size=30)
    return {f"row{k}": mean + common + 0.1 * rng.normal(size=30) for k, mean in enumerate(means)}


def test_a_row_is_marked_only_if_it_differs_from_every_other_row() -> None:
    rng = np.random.default_rng(2)
    assert marks.best([(TIME, rows(rng, 3.0, 2.0, 2.5))]) == {("time_s", "row1")}
    assert marks.best([(TIME, rows(rng, 3.0, 2.0, 2.001))]) == set()  # the next is as good, as far as anybody can tell
    assert marks.best([(CLOSEST, rows(rng, 3.0, 2.0, 2.5))]) == {("closest_m", "row0")}
    assert marks.best([(TIME, rows(rng, 1.0))]) == set()  # alone
    without = {**rows(rng, 3.0, 2.0), "none": np.full(30, np.nan)}
    assert marks.best([(TIME, without)]) == {("time_s", "row1")}
    assert marks.best([(FREE, {"a": np.ones(2), "b": np.zeros(2)})]) == set()  # too few flights
    assert marks.best([(FREE, {"a": np.ones(30), "b": np.zeros(30)})]) == {("free", "a")}


def test_where_no_row_is_better_one_table_in_twenty_has_a_mark_at_most() -> None:
    """Two rows that are equal and twelve that are far behind: the hardest case for whoever picks the best first. 300
    such tables of three columns; more than 25 with a mark would be beyond 5 % by more than chance (p < .006)."""
    rng = np.random.default_rng(4)
    measures = [BY_KEY[key] for key in ("time_s", "energy_J", "kbit")]
    wrong = 0
    for _ in range(300):
        means = [1.0, 1.0, *[5.0] * 12]
        wrong += bool(marks.best([(measure, rows(rng, *means)) for measure in measures]))
    assert wrong <= 25


@pytest.mark.parametrize(
    ("free", "flights", "safe"), [(28, 28, False), (29, 29, True), (30, 30, True), (29, 30, False), (60, 61, True)]
)
def test_a_row_is_safe_if_its_share_of_free_flights_is_above_ninety_per_cent(free, flights, safe) -> None:
    assert marks.is_safe(np.arange(flights) < free) is safe
    bound = stats.binomtest(free, flights).proportion_ci(0.90).low  # two-sided 90 %: one-sided 95 %
    assert (bound >= 0.9) is safe


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
    energy_front = front(PAPER, way * np.array([np.cos(heading), np.sin(heading)]))
    assert energy >= (1 - 5e-5) * energy_front.least_J(time)


@pytest.mark.parametrize(
    ("wind", "airspeed"),
    [((0.0, 0.0), 4.75), ((1.5, 0.0), 3.25), ((-1.5, 0.0), 6.25), ((0.0, 3.0), np.hypot(5.0, 3.0) - 0.25)],
    ids=["calm", "tail", "head", "cross"],
)
def test_the_front_depends_on_the_wind(wind: tuple[float, float], airspeed: float) -> None:
    """100 m in 20 s, 5 m of them inside the destination. A cross wind is flown against at √(v² + w²)."""
    energy_front = front(PAPER, np.array([100.0, 0.0]), np.array(wind))
    assert energy_front.least_J(20.0) == pytest.approx(20.0 * power(PAPER, np.array([airspeed]))[0], rel=1e-4)


def test_a_flight_that_ended_on_the_way_has_no_regret_for_being_cheap() -> None:
    fronts = Fronts(Scenario(uavs=2))
    least = [each.least_J(PAPER.duration) for each in fronts.each or ()]
    flown = {"lost": 0, "failures": [], "travel_s": [None, None], "energy_J": [least[0] + 1.0, least[1] + 3.0]}
    assert fronts.regret(flown) == pytest.approx(2.0)
    assert fronts.regret(flown | {"energy_J": [least[0] + 1.0, least[1] - 0.1]}) is None
