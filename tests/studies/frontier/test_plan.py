"""Plans keep their level: closed forms, and simulated searches whose policies are all too bad."""

import numpy as np
import pytest

from meanflock.groundstation import statistics
from meanflock.studies.frontier.plan import ALPHA, shortest


@pytest.mark.parametrize(
    ("target", "failures", "flights"),
    [(0.9, 0, 29), (0.95, 0, 59), (0.99, 0, 299), (0.9, 1, 46), (0.95, 1, 93), (0.9, 2, 61), (0.99, 1, 473)],
)
def test_a_plan_is_the_shortest_whose_bound_reaches_the_target(target: float, failures: int, flights: int) -> None:
    found = shortest(target, failures)
    assert found.flights == flights
    assert statistics.share_at_least(flights - failures, flights) >= target
    assert statistics.share_at_least(flights - failures - 1, flights - 1) < target
    assert found.acceptance(target) <= ALPHA


def test_the_bound_without_failures_has_a_closed_form() -> None:
    """P(n free flights | share p) = pⁿ, so the bound is the n-th root of α."""
    for flights in (1, 10, 29, 59):
        assert statistics.share_at_least(flights, flights) == pytest.approx(ALPHA ** (1 / flights))
        assert shortest(0.9).acceptance(0.97) == pytest.approx(0.97**29)
    assert statistics.share_at_least(0, 10) == 0.0


def test_an_answer_comes_early_only_when_it_is_certain() -> None:
    one = shortest(0.9, 1)
    assert one.answer([True] * 45) == "open"
    assert one.answer([True] * 45 + [False]) == "accepted"
    assert one.answer([False, True]) == "open"
    assert one.answer([False, True, False]) == "rejected"
    assert one.answer([True] * 46 + [False] * 9) == "accepted"  # later flights belong to another target


def test_simulated_flights_at_the_target_are_accepted_as_often_as_the_closed_form_says() -> None:
    draw = np.random.default_rng(29)
    trials = 4000
    for target, failures in ((0.9, 0), (0.9, 2), (0.95, 1)):
        one = shortest(target, failures)
        free = draw.random((trials, one.flights)) < target
        accepted = np.mean([one.answer(flights.tolist()) == "accepted" for flights in free])
        error = 4.0 * np.sqrt(ALPHA / trials)
        assert accepted == pytest.approx(one.acceptance(target), abs=error)
        assert accepted <= ALPHA + error
