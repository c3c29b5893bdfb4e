"""Which points are significantly best, and which are on the Pareto front: worked by hand, and by simulated seeds."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.results.better import better
from meanflock.results.quantities import COMPARED
from meanflock.studies.objectives import SHORT, Objective, objective
from meanflock.studies.tradeoff import tradeoff
from meanflock.studies.verdicts import verdicts

COST = Objective("cost", ("cost",), "less")
GAIN = Objective("gain", ("last_round.metric_gain", "last_round.mean_gain"), "more")
PLAN, LEARNS = mf.Scenario(method="plan"), mf.Scenario(method="fed-lspi")
GROUPED = mf.Scenario(uavs=4, method="plan", groups=[{"name": "bold", "count": 2}, {"name": "wary", "count": 2}])


def flights(**columns: list[float]) -> list[dict[str, Any]]:
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def test_every_compared_quantity_has_a_better_end() -> None:
    assert [better(key) for key in COMPARED] == ["less"] * 6 + ["more"]
    assert better("last_round.metric_accuracy") == better("last_round.mean_accuracy") == "more"
    assert better("seed") is None


def test_rivals_differ_in_the_method_and_the_best_is_marked_only_if_it_is_significant() -> None:
    noise = np.random.default_rng(1).normal(size=8)
    cost = {
        ("fdma", "a"): noise,
        ("fdma", "b"): noise + 1.0 + 0.01 * noise,  # worse in every flight, by more than it varies
        ("tdma", "a"): noise,
        ("tdma", "b"): noise[::-1] + 0.01,  # worse in the mean, not in every flight
        ("csma", "a"): noise,
        ("csma", "b"): noise,
    }
    points = {point: flights(cost=list(values)) for point, values in cost.items()}
    found = verdicts(("radio.access", "method"), points, [COST])
    assert [found[point, "cost"] for point in points] == ["best", "worse", *["undecided"] * 2, *["equal"] * 2]


def test_the_method_of_a_group_has_rivals_and_the_methods_of_all_groups_differ_with_it() -> None:
    names = ("groups.couriers.method", "radio.access", "method")
    cost = {
        ("orca", "fdma", "hjb+orca"): [1.0, 2.0, 3.0],
        ("bvc", "fdma", "hjb+bvc"): [11.0, 12.1, 13.0],
        ("orca", "tdma", "hjb+orca"): [11.0, 12.1, 13.0],
        ("bvc", "tdma", "hjb+bvc"): [1.0, 2.0, 3.0],
    }
    found = verdicts(names, {point: flights(cost=values) for point, values in cost.items()}, [COST])
    assert [found[point, "cost"] for point in cost] == ["best", "worse", "worse", "best"]


def test_without_several_methods_all_points_are_rivals_and_one_flight_decides_nothing() -> None:
    points = {(1,): flights(cost=[1.0, 2.0, 3.0]), (2,): flights(cost=[11.0, 12.1, 13.0])}
    assert list(verdicts(("uavs",), points, [COST]).values()) == ["best", "worse"]
    assert verdicts(("uavs",), {point: each[:1] for point, each in points.items()}, [COST]) == {}
    assert verdicts(("uavs",), {point: flights(other=[1.0, 2.0]) for point in points}, [COST]) == {}


def test_under_the_null_hypothesis_a_study_marks_a_best_in_one_of_twenty_at_most() -> None:
    """Holm's method holds the error of the family, here of three methods and two objectives."""
    draws = np.random.default_rng(7)
    other = Objective("gain", ("gain",), "more")
    wrong = 0
    for _ in range(400):
        points = {(name,): flights(cost=list(draws.normal(size=6)), gain=list(draws.normal(size=6))) for name in "abc"}
        wrong += "worse" in verdicts(("method",), points, [COST, other]).values()
    assert wrong / 400 < 0.09  # the best is chosen from the same flights, so a little above 5 %


def test_a_point_is_dominated_only_beyond_doubt() -> None:
    sure, noise = [0.1, 0.2, 0.3], [0.0, 5.0, -5.0]
    found = tradeoff(
        {
            ("cheap",): flights(cost=[1.0, 1.1, 1.2], gain=sure),
            ("dear",): flights(cost=[5.0, 5.1, 5.2], gain=sure),  # the same gain for more
            ("good",): flights(cost=[9.0, 9.1, 9.2], gain=[9.0, 9.2, 9.1]),
            ("noisy",): flights(cost=[9.5, 9.6, 9.7], gain=noise),
            ("lost",): flights(cost=[7.0, 7.1, 7.2], gain=[1.0, float("nan"), 1.0]),
        },
        COST,
        Objective("gain", ("gain",), "more"),
    )
    assert {point: one.place for (point,), one in found.placed.items()} == {
        "cheap": "front",
        "dear": "dominated",
        "good": "front",
        "noisy": "undecided",
        "lost": "",
    }
    assert (found.placed["cheap",].x.n, found.placed["lost",].y.n) == (3, 2)


def test_one_flight_each_leaves_the_front_undecided_and_equal_points_share_a_place() -> None:
    points = {(name,): flights(cost=[cost], gain=[1.0]) for name, cost in (("a", 1.0), ("b", 2.0), ("c", 1.0))}
    found = tradeoff(points, COST, Objective("gain", ("gain",), "more"))
    assert {one.place for one in found.placed.values()} == {"undecided"}
    same = {(name,): flights(cost=[1.0, 2.0], gain=[1.0, 2.0]) for name in "ab"}
    assert {one.place for one in tradeoff(same, COST, COST).placed.values()} == {"front"}


@pytest.mark.parametrize(
    ("text", "key", "end"),
    [
        ("bits", "payload_bits.total", "less"),
        ("airtime", "radio.airtime_s", "less"),
        ("arrived", "arrived", "more"),
        ("seed=more", "seed", "more"),
        ("energy_mean_J=more", "energy_mean_J", "more"),
        ("payload_bits.uplink", "payload_bits.uplink", "less"),
        ("tracking_cost", "last_round.metric_tracking_cost", "less"),
        ("k1=less", "last_round.metric_k1", "less"),
        ("groups.wary.energy_mean_J", "groups.wary.energy_mean_J", "less"),
        ("groups.bold.payload_bits.state", "groups.bold.payload_bits.state", "less"),
        ("groups.bold.arrived", "groups.bold.arrived", "more"),
    ],
)
def test_a_field_is_found_by_its_key_a_short_name_or_what_methods_report(text: str, key: str, end: str) -> None:
    found = objective(text, [PLAN, LEARNS, GROUPED], "--pareto")
    assert (found.keys[0], found.better) == (key, end)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("bit", "did you mean 'bits'"),
        ("energy_mean", "did you mean 'energy_mean_J'"),
        ("tracking_cots", "did you mean 'tracking_cost'"),
        ("accuracy", "methods report of a round: .*tracking_cost"),
        ("trajectory_sha256", "no flight has such a number"),
        ("seed", "Write seed=less or seed=more"),
        ("k1", "Write k1=less or k1=more"),
        ("bits=fewer", "NAME=less or NAME=more"),
        ("groups.wry.energy_mean_J", "did you mean 'groups.wary.energy_mean_J'"),
    ],
)
def test_a_field_that_no_flight_has_is_refused_with_advice(text: str, said: str) -> None:
    with pytest.raises(mf.BadInput, match=f"--pareto {text}: .*{said}"):
        objective(text, [PLAN, LEARNS, GROUPED], "--pareto")


def test_the_short_names_are_labelled_by_what_they_measure() -> None:
    labels = {name: objective(f"{name}=less", [PLAN, LEARNS], "--pareto").label for name in SHORT}
    assert labels["energy"] == "energy of all UAVs, whole flight (J)"
    assert labels["bits"] == "payload (bits)"
    of_group = objective("groups.wary.energy_mean_J", [GROUPED], "--pareto")
    assert of_group.label == "wary: energy until own arrival (J)"
    assert len({*labels.values(), objective("energy_mean_J", [PLAN, LEARNS], "--pareto").label}) == len(SHORT) + 1


def test_a_metric_counts_before_a_diagnostic_and_an_unknown_number_is_not_a_number() -> None:
    rounds = [{"metric_gain": 1.0, "mean_gain": 2.0}, {"mean_gain": 2.0}, {"mean_gain": None}, {}]
    values = GAIN.values([{"last_round": each} for each in rounds])
    assert values[:2] == [1.0, 2.0]
    assert np.isnan(values[2:]).all()
