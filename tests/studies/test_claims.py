"""Verdicts on data whose answer is known, both ways, for every kind of check."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from meanflock.studies.paper import claims
from meanflock.studies.paper.claims import Check, Claim
from meanflock.studies.paper.verdict import (
    BY_CONSTRUCTION,
    HOLDING,
    NOT_REFUTED,
    NOT_REPRODUCED,
    NOT_TESTABLE,
    REPRODUCED,
    UNDECIDED,
    evaluate,
    judge,
)
from meanflock.studies.paper.view import View
from tests.studies.synthetic import gridded, noisy, results, row

HF, H, F, HJB = "mfgfl-hf", "mfgfl-h", "mfgfl-f", "hjb"


def verdict(rows: list[dict[str, Any]], measured: dict[str, list[float]] | None = None, **check: Any) -> str:
    """The verdict on a claim of one check."""
    view = View.of(results(rows), measured)
    claim = Claim(id="C1", figure="", statement="", metric="", scenario="", check=(Check(**check),))
    return str(judge(view, claim)["verdict"])


def test_all_53_claims_are_there_once_and_in_order() -> None:
    assert [claim.id for claim in claims.load()] == [f"C{k}" for k in range(1, 54)]


def test_every_claim_says_what_where_and_how() -> None:
    for claim in claims.load():
        assert claim.statement.endswith(".")
        assert claim.metric
        assert claim.scenario
        assert claim.figure


@pytest.mark.parametrize(
    "broken",
    [
        {"kind": "order", "metric": "x", "subject": (HF,)},
        {"kind": "ratio", "metric": "x", "subject": (HF,), "against": (H,)},
        {"kind": "trend", "metric": "x", "subject": (HF,), "direction": "little gain"},
        {"kind": "bound", "metric": "x", "threshold": 1.0},
    ],
)
def test_a_check_that_lacks_what_its_kind_needs_is_refused(broken: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"needs|names"):
        Check(**broken)


def test_without_data_nothing_is_testable_and_every_record_is_whole() -> None:
    records = evaluate(results([row("nothing", HF, 1)]))
    assert [record["id"] for record in records] == [*(f"C{k}" for k in range(1, 54)), *(f"O{k}" for k in range(1, 10))]
    for record in records:
        assert record["verdict"] == NOT_TESTABLE
        assert len(record["reason"]) > 5
        assert {"id", "figure", "statement", "metric", "scenario", "value", "ci95", "threshold", "kind"} <= set(record)


def test_claims_no_data_can_decide_say_why_and_still_show_what_there_is() -> None:
    records = {r["id"]: r for r in evaluate(results(noisy("pair_distance_125", {HF: 1.0, H: 2.0, F: 2.0, HJB: 2.0})))}
    assert records["C51"]["verdict"] == NOT_TESTABLE
    assert "α = 0" in records["C51"]["reason"]
    assert records["C51"]["value"][HF] < records["C51"]["value"][HJB]
    assert records["C53"]["verdict"] == NOT_TESTABLE


def test_a_claim_of_which_one_check_has_no_data_is_undecided() -> None:
    """Frequent collisions of hjb are there, the traffic that C52 also speaks of is not."""
    flown = [*noisy("energy_mean_J", {"mfg": 1.0, HJB: 2.0}), *noisy("nothing", {HF: 1.0})]
    record = {r["id"]: r for r in evaluate(results(flown))}["C52"]
    assert record["verdict"] == UNDECIDED
    assert "no data" in record["reason"]


# -- one test a kind, both ways and undecided ------------------------------------------------------------


ORDER = {"kind": "order", "metric": "x", "subject": (HF,), "against": (H, F)}


@pytest.mark.parametrize(
    ("levels", "direction", "expected"),
    [
        ({HF: 1.0, H: 1.5, F: 2.0}, "lower", REPRODUCED),
        ({HF: 1.0, H: 1.5, F: 0.5}, "lower", NOT_REPRODUCED),
        ({HF: 3.0, H: 1.5, F: 2.0}, "higher", REPRODUCED),
        ({HF: 1.0, H: 1.0, F: 2.0}, "lower", UNDECIDED),  # equal: the interval holds zero
        ({HF: 1.0, H: 1.0, F: 0.5}, "lower", NOT_REPRODUCED),  # one fails, whatever the other leaves open
    ],
)
def test_order(levels: dict[str, float], direction: str, expected: str) -> None:
    assert verdict(noisy("x", levels), direction=direction, **ORDER) == expected


def test_pairing_by_seed_sees_what_unpaired_means_cannot() -> None:
    rows = noisy("x", {HF: 10.0, H: 10.2}, noise=0.05)  # seeds differ by 0.5, methods by 0.2
    values = {m: [r["x"] for r in rows if r["method"] == m] for m in (HF, H)}
    unpaired = stats.ttest_ind(values[HF], values[H]).confidence_interval()
    assert unpaired.low < 0 < unpaired.high
    assert verdict(rows, kind="order", metric="x", subject=(HF,), against=(H,)) == REPRODUCED


@pytest.mark.parametrize(("level", "expected"), [(0.78, REPRODUCED), (0.84, UNDECIDED), (0.95, NOT_REPRODUCED)])
def test_ratio(level: float, expected: str) -> None:
    rows = noisy("x", {HF: 100 * level, H: 100.0})
    assert verdict(rows, kind="ratio", metric="x", subject=(HF,), against=(H,), threshold=0.84) == expected


@pytest.mark.parametrize(("level", "expected"), [(1.1, REPRODUCED), (1.0, NOT_REPRODUCED), (1.2, NOT_REPRODUCED)])
def test_equal_ratio(level: float, expected: str) -> None:
    rows = noisy("x", {HF: 100 * level, H: 100.0})
    check = {"kind": "equal", "metric": "x", "subject": (HF,), "against": (H,), "threshold": 1.1, "tolerance": 0.05}
    assert verdict(rows, **check) == expected


@pytest.mark.parametrize(("level", "expected"), [(175.0, REPRODUCED), (150.0, NOT_REPRODUCED)])
def test_equal_value(level: float, expected: str) -> None:
    rows = noisy("x", {HF: level})
    assert verdict(rows, kind="equal", metric="x", subject=(HF,), threshold=175.0, tolerance=0.05) == expected


@pytest.mark.parametrize(
    ("level", "direction", "expected"),
    [
        (1.0, "lower", REPRODUCED),
        (2.0, "lower", NOT_REPRODUCED),
        (2.0, "higher", REPRODUCED),
        (1.5, "higher", UNDECIDED),
    ],
)
def test_bound(level: float, direction: str, expected: str) -> None:
    rows = noisy("x", {HF: level})
    assert verdict(rows, kind="bound", metric="x", subject=(HF,), threshold=1.5, direction=direction) == expected


@pytest.mark.parametrize(("direction", "expected"), [("lower", NOT_REPRODUCED), ("higher", REPRODUCED)])
def test_what_is_infinite_for_certain_is_above_every_bound(direction: str, expected: str) -> None:
    check = {"kind": "bound", "experiment": "offline", "metric": "x", "subject": ("offline",), "at": 0.0}
    rows = [row("offline", "offline", 1, sigma=0.0, x=math.inf)]
    assert verdict(rows, threshold=1.5, direction=direction, **check) == expected


def test_an_infinite_value_is_never_bounded() -> None:
    rows = [row("s0", HF, seed, x=math.inf if seed == 3 else 1.0) for seed in range(10)]
    assert verdict(rows, kind="bound", metric="x", subject=(HF,), threshold=1.5) == UNDECIDED


@pytest.mark.parametrize(
    ("hits", "event", "expected"),
    [
        (0, "none", REPRODUCED),
        (8, "none", UNDECIDED),  # 12 of 20 free: the exact interval holds one half
        (20, "some", REPRODUCED),
        (2, "some", NOT_REPRODUCED),
    ],
)
def test_share(hits: int, event: str, expected: str) -> None:
    rows = [row("s0", HF, seed, x=3 if seed < hits else 0) for seed in range(20)]
    assert verdict(rows, kind="share", metric="x", subject=(HF,), event=event, threshold=0.5) == expected


@pytest.mark.parametrize(("count", "expected"), [(5, REPRODUCED), (10, UNDECIDED), (20, NOT_REPRODUCED)])
def test_rate(count: int, expected: str) -> None:
    rows = [row("s0", HF, seed, x=count) for seed in range(20)]
    assert verdict(rows, kind="rate", metric="x", subject=(HF,), threshold=10.0) == expected


@pytest.mark.parametrize(
    ("direction", "change", "expected"),
    [
        ("falling", -1.0, REPRODUCED),
        ("falling", 1.0, NOT_REPRODUCED),
        ("falling", 0.0, UNDECIDED),
        ("rising", 1.0, REPRODUCED),
        ("rising", -1.0, NOT_REPRODUCED),
        ("little gain", 0.0, REPRODUCED),
        ("little gain", 2.0, REPRODUCED),  # worse is no gain
        ("little gain", -2.0, NOT_REPRODUCED),
    ],
)
def test_trend(direction: str, change: float, expected: str) -> None:
    line = {n: 10.0 + change * (n - 16) / 48 for n in (16, 25, 36, 49, 64)}
    rows = gridded("x", "uavs", "uavs", {HF: line})
    check = {"kind": "trend", "experiment": "uavs", "metric": "x", "subject": (HF,), "direction": direction}
    assert verdict(rows, threshold=0.1, **check) == expected


@pytest.mark.parametrize(("mine", "expected"), [(1.0, REPRODUCED), (3.0, NOT_REPRODUCED), (2.0, UNDECIDED)])
def test_slope(mine: float, expected: str) -> None:
    lines = {m: {s: 5 + slope * s for s in (0.1, 0.3, 0.5)} for m, slope in ((HF, mine), (H, 2.0))}
    rows = gridded("x", "wind", "sigma", lines)
    check = {"kind": "slope", "experiment": "wind", "metric": "x", "subject": (HF,), "against": (H,)}
    assert verdict(rows, **check) == expected


@pytest.mark.parametrize(("last", "expected"), [(2.0, REPRODUCED), (0.5, NOT_REPRODUCED), (1.0, UNDECIDED)])
def test_point(last: float, expected: str) -> None:
    rows = gridded("x", "period", "period", {HF: {100: 1.0, 200: 1.0, 500: last}})
    assert verdict(rows, kind="point", experiment="period", metric="x", subject=(HF,), at=500.0) == expected


@pytest.mark.parametrize(("lowest", "expected"), [(0.4, REPRODUCED), (0.7, NOT_REPRODUCED)])
def test_best_case_takes_the_best_point_and_baseline(lowest: float, expected: str) -> None:
    lines = {HF: {16: 0.9, 64: lowest}, H: {16: 1.0, 64: 1.0}, F: {16: 0.95, 64: 0.9}}
    check = {"kind": "best", "metric": "x", "experiments": ("uavs",), "subject": (HF,), "against": (H, F)}
    assert verdict(gridded("x", "uavs", "uavs", lines), threshold=0.5, **check) == expected


def test_a_best_case_of_nothing_but_noise_is_undecided() -> None:
    draw = np.random.default_rng(3)
    rows = [
        row("uavs", method, seed, uavs=n, x=float(draw.lognormal(0.0, 0.6)))
        for method in (HF, H, F, HJB)
        for n in range(2, 42)
        for seed in range(4)
    ]
    check = {"kind": "best", "metric": "x", "experiments": ("uavs",), "subject": (HF,), "against": (H, F, HJB)}
    assert verdict(rows, threshold=0.25, **check) == UNDECIDED


def test_a_best_case_that_fails_leaves_open_what_another_leaves_open() -> None:
    rows = noisy("x", {HF: 0.9, H: 1.0}, noise=0.001)  # a tenth less, for certain
    rows += [row("s0", F, seed, x=1.8 + 2.0 * (seed % 2)) for seed in {each["seed"] for each in rows}]
    check = {"kind": "best", "metric": "x", "experiments": ("s0",), "subject": (HF,)}
    assert verdict(rows, threshold=0.7, against=(H,), **check) == NOT_REPRODUCED
    assert verdict(rows, threshold=0.7, against=(H, F), **check) == UNDECIDED


def test_a_best_case_says_how_many_uavs_never_arrive() -> None:
    levels = {HF: (1.0, 25), H: (1.5, 25), F: (4.0, 20)}
    rows = [
        row("s0", method, seed, x=level + 0.001 * seed, arrived=arrived)
        for method, (level, arrived) in levels.items()
        for seed in range(5)
    ]
    check = Check(kind="best", metric="x", experiments=("s0",), subject=(HF,), against=(H, F), threshold=0.25)
    claim = Claim(id="C1", figure="", statement="", metric="", scenario="", check=(check,))
    record = judge(View.of(results(rows)), claim)
    assert "20 % of the UAVs of mfgfl-f never arrive at S0" in record["reason"]
    assert record["value"]["never_arrived, mfgfl-f"] == pytest.approx(0.2)
    assert "arrive" not in judge(View.of(results([each for each in rows if each["method"] != F])), claim)["reason"]


@pytest.mark.parametrize(
    ("kind", "holding"),
    [("measured", REPRODUCED), ("by construction", BY_CONSTRUCTION), ("no divergence", NOT_REFUTED)],
)
def test_only_a_claim_that_could_fail_is_called_reproduced(kind: claims.Basis, holding: str) -> None:
    check = Check(kind="bound", metric="x", subject=(HF,), threshold=1.5)
    claim = Claim(id="C1", kind=kind, figure="", statement="", metric="", scenario="", check=(check,))
    found = {level: judge(View.of(results(noisy("x", {HF: level}))), claim) for level in (1.0, 1.5, 2.0)}
    assert [record["verdict"] for record in found.values()] == [holding, UNDECIDED, NOT_REPRODUCED]
    assert found[1.0]["verdict"] in HOLDING
    assert found[1.0]["reason"].startswith("it holds")


def test_most_points_suffice_where_the_claim_says_so() -> None:
    lines = {HF: {50: 1.0, 100: 1.0, 200: 2.0}, H: {50: 1.5, 100: 1.5, 200: 1.5}}
    rows = gridded("x", "period", "period", lines)
    check = {"kind": "order", "experiment": "period", "metric": "x", "subject": (HF,), "against": (H,)}
    assert verdict(rows, points="most", **check) == REPRODUCED
    assert verdict(rows, points="all", **check) == NOT_REPRODUCED
    assert verdict(rows, points="all", stop=100.0, **check) == REPRODUCED
    lines = {HF: {50: 1.0, 100: 1.5, 200: 2.0}, H: {50: 1.5, 100: 1.5, 200: 1.5}}
    rows = gridded("x", "period", "period", lines)  # one holds, one is undecided, one fails
    assert verdict(rows, points="most", **check) == UNDECIDED
    assert verdict(rows, points="most", start=100.0, **check) == NOT_REPRODUCED


def test_measured_numbers_are_checked_like_runs() -> None:
    check = {"kind": "bound", "source": "theory", "metric": "growth", "threshold": 1.1}
    assert verdict([row("s0", HF, 1)], {"growth": [0.99, 1.0, 1.01]}, **check) == REPRODUCED
    assert verdict([row("s0", HF, 1)], {"growth": [1.5, 1.6, 1.7]}, **check) == NOT_REPRODUCED
    assert verdict([row("s0", HF, 1)], {}, **check) == NOT_TESTABLE


def test_one_seed_is_not_testable_unless_there_is_no_chance_in_it() -> None:
    assert verdict([row("s0", HF, 1, x=0.0), row("s0", H, 1, x=1.0), row("s0", F, 1, x=1.0)], **ORDER) == NOT_TESTABLE
    check = {"kind": "share", "experiment": "offline", "metric": "x", "subject": ("offline",), "event": "none"}
    calm = [row("offline", "offline", 1, sigma=0.0, x=0)]
    assert verdict(calm, at=0.0, threshold=0.5, **check) == REPRODUCED
    assert verdict([{**calm[0], "x": 2}], at=0.0, threshold=0.5, **check) == NOT_REPRODUCED


def test_two_runs_of_a_seed_in_one_cell_are_refused() -> None:
    rows = [row("offline", "offline", 1, x=0), row("offline", "offline", 1, x=1, setting="start.spacing=6")]
    check = {"kind": "share", "experiment": "offline", "metric": "x", "subject": ("offline",), "threshold": 0.5}
    with pytest.raises(ValueError, match="several runs a seed"):
        verdict(rows, at=0.1, **check)
    assert verdict(rows, at=0.1, setting="", **check) == NOT_TESTABLE


def test_a_reason_tells_refuted_from_undecided() -> None:
    def reason(levels: dict[str, float]) -> str:
        view = View.of(results(noisy("x", levels)))
        claim = Claim(id="C1", figure="", statement="", metric="", scenario="", check=(Check(**ORDER),))
        return str(judge(view, claim)["reason"])

    assert "speak against it: x: mfgfl-hf − mfgfl-f" in reason({HF: 1.0, H: 1.5, F: 0.5})
    assert "1 of 2 comparisons are undecided; the data leave it open: x: mfgfl-hf − mfgfl-h" in reason(
        {HF: 1.0, H: 1.0, F: 2.0}
    )
