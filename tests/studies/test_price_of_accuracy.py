"""The page on the price of 90 % accuracy: its tables, flights that never reached it, and a flight flown again."""

import math
from typing import Any

import pytest

from meanflock.results.statistics import Estimate
from meanflock.studies import published
from meanflock.studies.study import summarised
from meanflock.swarm import plugins
from research.price_of_accuracy import flights, page
from research.price_of_accuracy.expected import EXPECTED, LESS
from research.price_of_accuracy.flights import WAYS, MissionWay

CODE, ROWS = published.read_rows(page.RESULTS)
OWN, OTHER = MissionWay("paper", "neighbours"), MissionWay("paper", "leader")


def test_every_case_has_its_seeds() -> None:
    flown = [(MissionWay(row["mission"], row["way"]), row["seed"]) for row in ROWS]
    assert flown == [(case, seed) for case in flights.cases() for seed in flights.seeds(case)]


def test_every_way_is_compared_with_one_that_flies_the_same_missions() -> None:
    for name, way in WAYS.items():
        assert not way.against or set(way.missions) <= set(WAYS[way.against].missions), name
    assert {case for one in EXPECTED for case in (one.case, one.against)} <= set(flights.cases())


def test_the_page_has_the_tables_of_its_results() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.page(text, CODE, ROWS) == text, "run `python -m research.price_of_accuracy --page`"


def arm(*mbit: float, never: int = 0) -> list[dict[str, Any]]:
    """Flights of so many Mbit, of which the last ones never reached 90 %."""
    return [{"mbit": one, "reached": place < len(mbit) - never} for place, one in enumerate(mbit)]


def test_a_flight_that_never_reached_it_leaves_a_ratio_without_a_bound() -> None:
    def ratio(own: list[dict[str, Any]], other: list[dict[str, Any]]) -> Estimate:
        return page.ratio({OWN: own, OTHER: other}, OWN, OTHER, "mbit")

    both = ratio(arm(2.0, 4.0, 2.2), arm(1.0, 2.0, 1.0))
    assert both.value == pytest.approx(8.8 ** (1 / 3))
    assert 0.0 < both.low < both.value < both.high < math.inf
    assert ratio(arm(2.0, 4.0, 2.2, never=1), arm(1.0, 2.0, 1.0)) == Estimate(both.value, both.low, math.inf, 3)
    assert ratio(arm(2.0, 4.0, 2.2), arm(1.0, 2.0, 1.0, never=1)) == Estimate(both.value, 0.0, both.high, 3)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.2, 0.9, "confirmed"),
        (1.1, math.inf, "refuted"),
        (0.9, 1.1, "undecided"),
        (0.0, math.inf, "undecided"),
    ],
)
def test_an_expectation_is_confirmed_or_refuted_by_the_whole_interval(low: float, high: float, verdict: str) -> None:
    assert page.verdict(Estimate(0.5, low, high, 10), *LESS) == verdict


def test_a_repeated_flight_has_the_published_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"KMP_DUPLICATE_LIB_OK": "True", "KMP_INIT_AT_FORK": "FALSE"}.items():
        monkeypatch.setenv(name, value)  # as sklearn does, for good, when it is imported
    plugins.load_files(flights.PLUGINS)
    row = next(one for one in ROWS if MissionWay(one["mission"], one["way"]) == OWN)
    summary = summarised(flights.scenario(OWN, row["rate"], row["seed"]))
    assert flights.flight_of(OWN, row["rate"], row["seed"], summary) == pytest.approx(row)
