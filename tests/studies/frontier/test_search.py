"""Plans and searches keep their level: closed forms, simulated flights, and no more flights than are needed."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import stats

from meanflock.results import statistics
from meanflock.studies.frontier.sampling import ALPHA, SamplingPlan, chance_of_error, shortest
from meanflock.studies.frontier.search import SURVEY, FlightOutcome, PolicyFlights, Search

PLANS = [shortest(0.9), shortest(0.95)]


def searched(
    shares: dict[str, float],
    draw: np.random.Generator,
    most: int = 59,
    arrived: float = 1.0,
    plans: Sequence[SamplingPlan] = PLANS,
) -> Search:
    """A search whose policies are free with these probabilities; earlier ones cost more."""
    costs = {name: 100.0 - number for number, name in enumerate(shares)}
    search = Search(list(shares), plans, most, {name: PolicyFlights() for name in shares})
    while wanted := search.wanted():
        for one in wanted:
            flights = search.flown[one.policy].outcomes(one.stage)
            assert len(flights) < one.flights <= most
            missing = one.flights - len(flights)
            free = draw.random(missing) < shares[one.policy]
            flights += [FlightOutcome(bool(is_free), costs[one.policy], arrived) for is_free in free]
    return search


def test_the_cheapest_safe_policy_is_named_and_dearer_ones_do_not_go_on() -> None:
    search = searched({"dear": 1.0, "safe": 1.0, "bad": 0.0}, np.random.default_rng(1))
    assert [search.reached(plan) for plan in PLANS] == ["safe", "safe"]
    assert [search.verdict(PLANS[0], name) for name in search.policies] == ["not needed", "reached", "collisions"]
    lengths = {name: (len(flown.search), len(flown.confirmation)) for name, flown in search.flown.items()}
    assert lengths == {"dear": (2, 0), "safe": (59, 59), "bad": (SURVEY, 0)}
    assert search.estimate() == 0


def test_a_target_that_needs_more_flights_than_there_are_is_never_reached() -> None:
    search = searched({"one": 1.0, "other": 1.0}, np.random.default_rng(1), most=10)
    assert [search.reached(plan) for plan in PLANS] == [None, None]
    assert {len(flown.search) for flown in search.flown.values()} == {10}
    assert search.verdict(PLANS[0], "one") == "too few flights"
    search = searched({"one": 1.0, "other": 1.0}, np.random.default_rng(1), most=29)
    assert [search.reached(plan) for plan in PLANS] == ["other", None]


def test_a_policy_is_not_named_if_its_uavs_stay_behind_or_its_confirmation_fails() -> None:
    search = searched({"stays": 1.0}, np.random.default_rng(1), arrived=0.98)
    assert search.verdict(PLANS[0], "stays") == "not arrived"
    assert not search.flown["stays"].confirmation
    free, collided = FlightOutcome(True, 1.0, 1.0), FlightOutcome(False, 1.0, 1.0)
    unlucky = Search(["one"], PLANS[:1], 59, {"one": PolicyFlights([free] * 29, [free, collided])})
    assert unlucky.verdict(PLANS[0], "one") == "not confirmed"
    assert unlucky.wanted() == []


def test_simulated_searches_name_a_bad_policy_no_more_often_than_the_bound() -> None:
    """With shares at a target of 50 %, which takes five flights: there the bound is nearly attained."""
    draw = np.random.default_rng(5)
    trials, plan = 600, shortest(0.5)
    shares = {str(number): plan.target for number in range(11)}
    searches = [searched(shares, draw, most=plan.flights, plans=[plan]) for _ in range(trials)]
    named = np.mean([search.reached(plan) is not None for search in searches])
    exact = 1.0 - (1.0 - plan.acceptance(plan.target) ** 2) ** len(shares)
    assert exact < chance_of_error(len(shares)) == pytest.approx(0.0275)
    assert named == pytest.approx(exact, abs=3.0 * np.sqrt(exact / trials))


@pytest.mark.parametrize(
    ("target", "failures", "flights"),
    [(0.9, 0, 29), (0.95, 0, 59), (0.99, 0, 299), (0.9, 1, 46), (0.95, 1, 93), (0.9, 2, 61), (0.99, 1, 473)],
)
def test_a_plan_is_the_shortest_whose_bound_reaches_the_target(target: float, failures: int, flights: int) -> None:
    found = shortest(target, failures)
    assert found.flights == flights
    assert statistics.share_at_least(flights - failures, flights) >= target
    assert statistics.share_at_least(flights - failures - 1, flights - 1) < target
    for share in (target, 0.97):
        assert found.acceptance(share) == pytest.approx(stats.binom.cdf(failures, flights, 1.0 - share))
    assert found.acceptance(target) <= ALPHA


def test_an_answer_comes_early_only_when_it_is_certain() -> None:
    one = shortest(0.9, 1)
    assert one.answer([True] * 45) == "open"
    assert one.answer([True] * 45 + [False]) == "accepted"
    assert one.answer([False, True]) == "open"
    assert one.answer([False, True, False]) == "rejected"
    assert one.answer([True] * 46 + [False] * 9) == "accepted"  # later flights belong to another target
