"""Verdicts on synthetic data with known answers: kinds of checks, single flights, settings, the map of regimes."""

import math
from collections.abc import Mapping
from typing import Any

import pytest

from research.reproduction import claims, grid, regimes
from research.reproduction.claims import Basis, Check, Claim
from research.reproduction.tables import View
from research.reproduction.verdict import (
    BY_CONSTRUCTION,
    HOLDING,
    NOT_REFUTED,
    NOT_REPRODUCED,
    NOT_TESTABLE,
    REPRODUCED,
    UNDECIDED,
    evaluate,
    has_single_flights,
    judge,
    shares,
    single_flights,
)
from tests.reproduction.synthetic import MAP, gridded, map_rows, noisy, results, row

HF, H, F, HJB = "mfgfl-hf", "mfgfl-h", "mfgfl-f", "hjb"
Rows = list[dict[str, Any]]


def record(
    rows: Rows, measured: dict[str, list[float]] | None = None, basis: Basis = "measured", **check: Any
) -> dict[str, Any]:
    """The record of a claim with one check of the metric x."""
    whole = Check(**{"metric": "x", "subject": (HF,), **check})
    claim = Claim(id="C1", kind=basis, figure="", statement="", metric="", scenario="", check=(whole,))
    return judge(View.from_results(results(rows), measured), claim)


def verdict(rows: Rows, measured: dict[str, list[float]] | None = None, **check: Any) -> str:
    return str(record(rows, measured, **check)["verdict"])


def test_a_claim_without_data_is_not_testable_and_says_why() -> None:
    for found in evaluate(results([row("nothing", HF, 1)])):
        assert found["verdict"] == NOT_TESTABLE
        assert len(found["reason"]) > 5
    rows = [*noisy("energy_mean_J", {"mfg": 1.0, HJB: 2.0}), *noisy("nothing", {HF: 1.0})]
    (c52,) = (each for each in evaluate(results(rows)) if each["id"] == "C52")  # only one check has no data
    assert (c52["verdict"], "no data" in c52["reason"]) == (UNDECIDED, True)


# -- the kinds of checks -----------------------------------------------------------------------------------------------


def levels(hf: float, h: float | None = None, f: float | None = None) -> Rows:
    """S0 runs with these means."""
    means = {HF: hf, H: h, F: f}
    return noisy("x", {method: mean for method, mean in means.items() if mean is not None})


def counts(*values: float) -> Rows:
    return [row("s0", HF, seed, x=value) for seed, value in enumerate(values)]


def sizes(change: float) -> Rows:
    """A line over N that starts at 10 and ends at 10 + `change`."""
    return gridded("x", "uavs", "uavs", {HF: {n: 10.0 + change * (n - 16) / 48 for n in (16, 25, 36, 49, 64)}})


def winds(slope: float) -> Rows:
    """A line over σ with this slope, beside one with a slope of 2."""
    lines = {m: {s: 5 + each * s for s in (0.1, 0.3, 0.5)} for m, each in ((HF, slope), (H, 2.0))}
    return gridded("x", "wind", "sigma", lines)


def periods(mine: Mapping[float, float], theirs: float = 1.5) -> Rows:
    return gridded("x", "period", "period", {HF: mine, H: dict.fromkeys(mine, theirs)})


def best(lowest: float) -> Rows:
    lines = {HF: {16: 0.9, 64: lowest}, H: {16: 1.0, 64: 1.0}, F: {16: 0.95, 64: 0.9}}
    return gridded("x", "uavs", "uavs", lines)


CALM = {"kind": "bound", "experiment": "offline", "subject": ("offline",), "at": 0.0, "threshold": 1.5}
ORDER = {"kind": "order", "against": (H, F)}
RATIO = {"kind": "ratio", "against": (H,), "threshold": 0.84}
EQUAL = {"kind": "equal", "against": (H,), "threshold": 1.1, "tolerance": 0.05}
VALUE = {"kind": "equal", "threshold": 175.0, "tolerance": 0.05}
BOUND = {"kind": "bound", "threshold": 1.5}
SHARE = {"kind": "share", "threshold": 0.5}
RATE = {"kind": "rate", "threshold": 10.0}
TREND = {"kind": "trend", "experiment": "uavs", "threshold": 0.1}
SLOPE = {"kind": "slope", "experiment": "wind", "against": (H,)}
POINT = {"kind": "point", "experiment": "period", "at": 500.0}
BEST = {"kind": "best", "experiments": ("uavs",), "against": (H, F), "threshold": 0.5}
PERIOD = {"kind": "order", "experiment": "period", "against": (H,)}
MIXED = {50: 1.0, 100: 1.5, 200: 2.0}  # one point holds, one is undecided, one fails
THEORY = {"kind": "bound", "source": "theory", "metric": "growth", "threshold": 1.1}
INFINITE = [row("offline", "offline", 1, sigma=0.0, x=math.inf)]


@pytest.mark.parametrize(
    ("check", "rows", "expected"),
    [
        (ORDER, levels(1.0, 1.2, 2.0), REPRODUCED),  # paired by seed; unpaired means would overlap
        (ORDER, levels(1.0, 1.5, 0.5), NOT_REPRODUCED),
        (ORDER, levels(1.0, 1.0, 2.0), UNDECIDED),  # equal: the interval holds zero
        (ORDER, levels(1.0, 1.0, 0.5), NOT_REPRODUCED),  # one comparison fails, so the open one does not matter
        (ORDER | {"direction": "higher"}, levels(3.0, 1.5, 2.0), REPRODUCED),
        (RATIO, levels(78.0, 100.0), REPRODUCED),
        (RATIO, levels(84.0, 100.0), UNDECIDED),
        (RATIO, levels(95.0, 100.0), NOT_REPRODUCED),
        (EQUAL, levels(110.0, 100.0), REPRODUCED),
        (EQUAL, levels(100.0, 100.0), NOT_REPRODUCED),
        (VALUE, levels(175.0), REPRODUCED),
        (VALUE, levels(150.0), NOT_REPRODUCED),
        (BOUND, levels(1.0), REPRODUCED),
        (BOUND, levels(2.0), NOT_REPRODUCED),
        (BOUND | {"direction": "higher"}, levels(2.0), REPRODUCED),
        (BOUND, counts(math.inf, *[1.0] * 9), UNDECIDED),  # a diverged run makes the interval unbounded
        (CALM, INFINITE, NOT_REPRODUCED),
        (SHARE | {"event": "none"}, counts(*[0] * 20), REPRODUCED),
        (SHARE | {"event": "none"}, counts(*[3] * 8, *[0] * 12), UNDECIDED),  # the exact interval holds one half
        (SHARE, counts(*[3] * 20), REPRODUCED),
        (SHARE, counts(*[3] * 2, *[0] * 18), NOT_REPRODUCED),
        (RATE, counts(*[5] * 20), REPRODUCED),
        (RATE, counts(*[10] * 20), UNDECIDED),
        (RATE, counts(*[20] * 20), NOT_REPRODUCED),
        (TREND | {"direction": "falling"}, sizes(-1.0), REPRODUCED),
        (TREND | {"direction": "falling"}, sizes(1.0), NOT_REPRODUCED),
        (TREND | {"direction": "falling"}, sizes(0.0), UNDECIDED),
        (TREND | {"direction": "little gain"}, sizes(2.0), REPRODUCED),  # a rise is no gain
        (TREND | {"direction": "little gain"}, sizes(-2.0), NOT_REPRODUCED),
        (SLOPE, winds(1.0), REPRODUCED),
        (SLOPE, winds(2.0), UNDECIDED),
        (SLOPE, winds(3.0), NOT_REPRODUCED),
        (POINT, periods({100: 1.0, 200: 1.0, 500: 2.0}), REPRODUCED),
        (POINT, periods({100: 1.0, 200: 1.0, 500: 1.0}), UNDECIDED),
        (POINT, periods({100: 1.0, 200: 1.0, 500: 0.5}), NOT_REPRODUCED),
        (BEST, best(0.4), REPRODUCED),
        (BEST, best(0.7), NOT_REPRODUCED),
        (PERIOD | {"points": "most"}, periods({50: 1.0, 100: 1.0, 200: 2.0}), REPRODUCED),
        (PERIOD, periods({50: 1.0, 100: 1.0, 200: 2.0}), NOT_REPRODUCED),
        (PERIOD | {"stop": 100.0}, periods({50: 1.0, 100: 1.0, 200: 2.0}), REPRODUCED),
        (PERIOD | {"points": "most"}, periods(MIXED), UNDECIDED),
        (PERIOD | {"points": "most", "start": 100.0}, periods(MIXED), NOT_REPRODUCED),
    ],
)
def test_a_verdict_follows_from_the_whole_interval(check: dict[str, Any], rows: Rows, expected: str) -> None:
    assert verdict(rows, **check) == expected


@pytest.mark.parametrize(
    ("values", "expected"), [([0.99, 1.0, 1.01], REPRODUCED), ([1.5, 1.6, 1.7], NOT_REPRODUCED), ([], NOT_TESTABLE)]
)
def test_measured_numbers_are_judged_like_runs(values: list[float], expected: str) -> None:
    assert verdict([row("s0", HF, 1)], {"growth": values}, **THEORY) == expected


@pytest.mark.parametrize(
    ("basis", "holding"),
    [("measured", REPRODUCED), ("by construction", BY_CONSTRUCTION), ("no divergence", NOT_REFUTED)],
)
def test_only_a_claim_that_could_fail_is_called_reproduced(basis: Basis, holding: str) -> None:
    found = [record(levels(level), basis=basis, **BOUND)["verdict"] for level in (1.0, 1.5, 2.0)]
    assert found == [holding, UNDECIDED, NOT_REPRODUCED]
    assert holding in HOLDING


def test_one_seed_is_testable_only_without_chance() -> None:
    single = [row("s0", HF, 1, x=0.0), row("s0", H, 1, x=1.0), row("s0", F, 1, x=1.0)]
    assert verdict(single, **ORDER) == NOT_TESTABLE
    check = SHARE | {"experiment": "offline", "subject": ("offline",), "event": "none", "at": 0.0}
    for crashes, expected in ((0, REPRODUCED), (2, NOT_REPRODUCED)):
        assert verdict([row("offline", "offline", 1, sigma=0.0, x=crashes)], **check) == expected


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (levels(1.0, 1.5, 2.0), "2 of 2 comparisons hold"),
        (levels(1.0, 1.5, 0.5), "speak against it: x: mfgfl-hf − mfgfl-f"),
        (levels(1.0, 1.0, 2.0), "1 of 2 comparisons are undecided; the data leave it open: x: mfgfl-hf − mfgfl-h"),
    ],
)
def test_a_reason_names_the_comparison_that_decided(rows: Rows, reason: str) -> None:
    assert reason in record(rows, **ORDER)["reason"]


CLAIMS = {claim.id: claim for claim in claims.load()}
SETTINGS = [setting for setting, _, _ in MAP]


def test_a_claim_that_fails_on_average_may_hold_in_single_flights() -> None:
    """The energy of mfgfl-hf is at most .84 of the others' in two of three flights; one flight lacks a method."""
    levels = {1: 0.8, 2: 0.9, 3: 0.8, 4: 0.8}
    runs = [
        row("s0", method, seed, energy_mean_J=level if method == "mfgfl-hf" else 1.0)
        for method in ("hjb", "mfgfl-h", "mfgfl-f", "mfgfl-hf")
        for seed, level in levels.items()
        if (method, seed) != ("hjb", 4)
    ]
    view = View.from_results(results(runs))
    assert single_flights(view, CLAIMS["C13"]) == (2, 3)
    assert single_flights(view, CLAIMS["C8"]) is None  # these runs have no collisions


def test_claims_about_grids_and_the_theory_have_no_single_flights() -> None:
    assert not any(has_single_flights(CLAIMS[name]) for name in ("C1", "C7", "C26", "C47", "C53"))
    assert all(has_single_flights(CLAIMS[name]) for name in ("C8", "C10", "C13", "C16", "C21"))


def test_each_setting_is_judged_as_if_it_were_s0() -> None:
    rows = noisy("bits_175", {"hjb": 4.0, "mfgfl-hf": 0.5})
    assert shares(results(rows)) == []
    for name, bits in (("a=1", 0.5), ("a=2", 3.0), ("a=3", 1.0)):
        flown = noisy("bits_175", {"hjb": 4.0, "mfgfl-hf": bits}, noise=0.001)
        rows += [{**each, "experiment": "sensitivity", "setting": name} for each in flown]
    found = {share.id: share for share in shares(results(rows))}
    traffic = found["C14"]  # at most a quarter
    assert (traffic.kept_by, traffic.against, traffic.undecided, traffic.settings) == (("a=1",), 1, 1, 3)
    assert not {"C53", "C27", "C13"} & set(found)  # untestable, not about S0, without data


@pytest.fixture(scope="module")
def places() -> list[regimes.MapPoint]:
    return regimes.places(View.from_results(results(map_rows())))


def test_a_setting_scores_the_share_of_flights_in_which_claims_hold(places: list[regimes.MapPoint]) -> None:
    default, slow, *_ = places
    assert [place.setting for place in places] == SETTINGS
    assert default.held["C13"] == (0, 2)
    # mfgfl-hf has no collision in one flight and as many as mfgfl-h in the other; no flight has the metric of C19
    assert {name: slow.held[name] for name in ("C13", "C8", "C9", "C19")} == {
        "C13": (2, 2),
        "C8": (1, 2),
        "C9": (1, 2),
        "C19": (0, 2),
    }
    assert slow.score == pytest.approx(sum(k / n for k, n in slow.held.values()))
    assert slow.score == default.score + 1
    assert not {"C3", "C14", "C24", "C25", "C18"} & set(slow.held)  # bits, residuals, and calibrated claims


def test_the_rule_chooses_the_best_among_the_allowed_settings(places: list[regimes.MapPoint]) -> None:
    assert grid.map_design() == grid.map_design()
    assert len(set(grid.map_design())) == grid.MAP_SETTINGS + len(grid.KNOWN)
    assert regimes.slow(places).setting == SETTINGS[1]  # the third has other rounds, in the last few UAVs arrive
    assert regimes.printed(places).setting == SETTINGS[3]
    assert SETTINGS[4] not in [place.setting for place in regimes.best(places)]
    assert [place.setting for place in regimes.best(places, 2)] == SETTINGS[1:3]
