"""The kinds of checks of a claim: each compares estimates from the tables with thresholds."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from research.reproduction.claims import Check
from research.reproduction.outcome import Outcome, Test, above, all_of, below, most_of, within
from research.reproduction.tables import COORDINATE, View, paired
from research.reproduction.traces import turn

Floats = NDArray[np.float64]
Tests = Iterator[tuple[str, Test]]  # each with the place on the grid it belongs to

SYMBOL = {"uavs": "N", "period": "n0", "sigma": "σ"}


@dataclass
class Findings:
    """Results of the checks of a claim: the tests, and their values by (metric, method, point).

    remarks: sentences about the data that a reader of the verdict should know.
    """

    tests: list[Test] = field(default_factory=list)
    values: dict[tuple[str, str, str], Estimate] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


# -- where the numbers of a check come from ----------------------------------------------------------------------------


def _label(check: Check, point: float | None) -> str:
    return "" if point is None else f"{SYMBOL[COORDINATE[check.experiment]]} = {point:g}"


def _points(view: View, check: Check) -> list[float]:
    """Points of the grid that a check uses."""

    def chosen(point: float) -> bool:
        return (
            (check.start is None or point >= check.start - 1e-9)
            and (check.stop is None or point <= check.stop + 1e-9)
            and (check.above is None or point > check.above + 1e-9)
        )

    return [point for point in view.points(check.experiment) if chosen(point)]


def _cells(view: View, check: Check) -> list[float | None]:
    """Places of a check: points of the grid, or the whole experiment as None."""
    if check.experiment not in COORDINATE:
        return [None]
    return [check.at] if check.at is not None else list(_points(view, check))


def _by_seed(view: View, check: Check, method: str, point: float | None) -> dict[int, float]:
    if check.source == "theory":
        return dict(enumerate(view.measured.get(check.metric, ())))
    if check.source == "turn":
        return dict(enumerate(turn(view, method, check.metric)))
    more = {
        name: value for name, value in (("setting", check.setting), ("trained", check.trained)) if value is not None
    }
    return view.values(check.experiment, method, check.metric, point, **more)


def _is_certain(check: Check, point: float | None) -> bool:
    """Returns whether the runs have no randomness, so that one of them is enough."""
    return COORDINATE.get(check.experiment) == "sigma" and point == 0.0


def _mean(check: Check, point: float | None, values: Mapping[int, float]) -> Estimate:
    if _is_certain(check, point) and len(values) == 1:
        return statistics.exact(next(iter(values.values())))
    return statistics.mean(list(values.values()))


def named(*parts: str) -> str:
    """The parts that are not empty, joined by commas."""
    return ", ".join(part for part in parts if part)


def _value(found: Findings, view: View, check: Check, method: str, point: float | None) -> dict[int, float]:
    """A method's values by seed; `found` gets their mean, or an entry in `missing`."""
    values = _by_seed(view, check, method, point)
    where = _label(check, point)
    if not values:
        found.missing.append(named(check.metric, method, where or check.experiment))
        return values
    if check.kind == "rate":
        found.values[check.metric, method, where] = statistics.rate(list(values.values()))
    elif check.kind != "share":
        found.values.setdefault((check.metric, method, where), _mean(check, point, values))
    return values


# -- one function a kind of check: every one yields tests --------------------------------------------------------------


def _single(view: View, check: Check, found: Findings) -> Iterator[tuple[str, str, float | None, dict[int, float]]]:
    """Subject, place, point and values by seed of every subject of the check."""
    for point in _cells(view, check):
        for subject in check.subject or ("",):
            yield subject, _label(check, point), point, _value(found, view, check, subject, point)


def _pairs(view: View, check: Check, found: Findings) -> Iterator[tuple[str, str, str, list[Floats]]]:
    """Subject, opponent, place and the two paired columns of every comparison of the check."""
    for subject, where, point, mine in _single(view, check, found):
        for other in check.against:
            theirs = _value(found, view, check, other, point)
            yield subject, other, where, paired(mine, theirs)


def _order(view: View, check: Check, found: Findings) -> Tests:
    judge = above if check.direction == "higher" else below
    for subject, other, where, columns in _pairs(view, check, found):
        label = named(f"{check.metric}: {subject} − {other}", where)
        yield where, judge(label, statistics.difference(*columns), 0.0, strict=True)


def _ratio(view: View, check: Check, found: Findings) -> Tests:
    assert check.threshold is not None
    for label, where, estimate in _ratios(view, check, found):
        yield where, below(label, estimate, check.threshold)


def _ratios(view: View, check: Check, found: Findings) -> Iterator[tuple[str, str, Estimate]]:
    for subject, other, where, columns in _pairs(view, check, found):
        yield named(f"{check.metric}: {subject} / {other}", where), where, statistics.ratio(*columns)


def _means(view: View, check: Check, found: Findings) -> Iterator[tuple[str, str, Estimate]]:
    for subject, where, point, values in _single(view, check, found):
        yield named(check.metric, subject, where), where, _mean(check, point, values)


def _equal(view: View, check: Check, found: Findings) -> Tests:
    assert check.threshold is not None
    low, high = check.threshold * (1 - check.tolerance), check.threshold * (1 + check.tolerance)
    for label, where, estimate in (_ratios if check.against else _means)(view, check, found):
        yield where, within(label, estimate, low, high)


def _bound(view: View, check: Check, found: Findings) -> Tests:
    assert check.threshold is not None
    judge = above if check.direction == "higher" else below
    for label, where, estimate in _means(view, check, found):
        yield where, judge(label, estimate, check.threshold, strict=True)


def _share(view: View, check: Check, found: Findings) -> Tests:
    assert check.threshold is not None
    label = f"share of runs with {'some' if check.event == 'some' else 'no'} {check.metric}"
    for subject, where, point, by_seed in _single(view, check, found):
        values = np.array(list(by_seed.values()))
        values = values[~np.isnan(values)]
        hits = values > 0 if check.event == "some" else values == 0
        certain = _is_certain(check, point) and len(hits) == 1
        estimate = statistics.exact(float(hits[0])) if certain else statistics.share(hits)
        if estimate.n:
            found.values[label, subject, where] = estimate
        yield where, above(named(label, subject, where), estimate, check.threshold, strict=True)


def _rate(view: View, check: Check, found: Findings) -> Tests:
    assert check.threshold is not None
    limit = check.threshold * (1 + check.tolerance)
    for subject in check.subject or ("",):
        estimate = statistics.rate(list(_value(found, view, check, subject, check.at).values()))
        yield "", below(named(f"{check.metric} a run", subject), estimate, limit, strict=True)


def _tables(view: View, check: Check, found: Findings, *methods: str) -> tuple[list[float], list[Floats]]:
    """The grid, and values (seeds, K) of each method for the seeds that all methods flew at every point."""
    grid = _points(view, check)
    columns = paired(*(_value(found, view, check, method, point) for method in methods for point in grid))
    return grid, [np.array(columns[k * len(grid) : (k + 1) * len(grid)]).T for k in range(len(methods))]


def _trend(view: View, check: Check, found: Findings) -> Tests:
    for subject in check.subject:
        grid, (rows,) = _tables(view, check, found, subject)
        if len(grid) < 2:
            found.missing.append(named(f"a grid of {check.experiment}", subject))
            continue
        rise = statistics.slopes(grid, rows) * (grid[-1] - grid[0])
        label = f"{check.metric}: {subject}, fitted change over {_label(check, grid[0])}…{grid[-1]:g}"
        if check.direction == "little gain":
            assert check.threshold is not None
            yield "", above(f"{label}, relative", statistics.ratio(rise, rows.mean(axis=-1)), -check.threshold)
        elif check.direction == "falling":
            yield "", below(label, statistics.mean(rise), 0.0, strict=True)
        else:
            yield "", above(label, statistics.mean(rise), 0.0, strict=True)


def _slope(view: View, check: Check, found: Findings) -> Tests:
    for subject in check.subject:
        for other in check.against:
            grid, (mine, theirs) = _tables(view, check, found, subject, other)
            if len(grid) < 2:
                found.missing.append(named(f"a grid of {check.experiment}", subject))
                continue
            gap = statistics.slopes(grid, mine) - statistics.slopes(grid, theirs)
            yield "", below(f"slope of {check.metric}: {subject} − {other}", statistics.mean(gap), 0.0, strict=True)


def _point(view: View, check: Check, found: Findings) -> Tests:
    assert check.at is not None
    for subject in check.subject:
        grid, (rows,) = _tables(view, check, found, subject)
        others = [k for k, point in enumerate(grid) if abs(point - check.at) > 1e-9]
        if len(others) != len(grid) - 1 or not others:
            found.missing.append(named(check.metric, subject, _label(check, check.at)))
            continue
        here = rows[:, next(k for k in range(len(grid)) if k not in others)]
        label = f"{check.metric}: {subject}, {_label(check, check.at)} − mean of the others"
        yield "", above(label, statistics.difference(here, rows[:, others].mean(axis=-1)), 0.0, strict=True)


@dataclass(frozen=True)
class _Case:
    """One comparison of a best case: two methods at one point of a grid, or in S0."""

    subject: str
    other: str
    experiment: str
    point: float | None
    columns: list[Floats]

    @property
    def where(self) -> str:
        return "S0" if self.point is None else f"{SYMBOL[COORDINATE[self.experiment]]} = {self.point:g}"


def _best(view: View, check: Check, found: Findings) -> Tests:
    assert check.threshold is not None
    cases: list[_Case] = []
    for experiment in check.experiments:
        grid: list[float | None] = list(view.points(experiment)) if experiment in COORDINATE else [None]
        for point in grid:
            for subject in check.subject:
                mine = view.values(experiment, subject, check.metric, point)
                for other in check.against:
                    theirs = view.values(experiment, other, check.metric, point)
                    columns = paired(mine, theirs)
                    if len(columns[0]) >= 2:
                        cases.append(_Case(subject, other, experiment, point, columns))
    if not cases:
        found.missing.append(named(check.metric, *check.experiments))
        return
    level = 1.0 - (1.0 - statistics.CONFIDENCE) / len(cases)
    tests: list[tuple[Test, _Case]] = []
    for case in cases:
        remaining = statistics.ratio(*case.columns, confidence=level)
        saved = Estimate(1.0 - remaining.value, 1.0 - remaining.high, 1.0 - remaining.low, remaining.n)
        if not math.isnan(saved.value):
            label = f"{check.metric}: best of {len(cases)} savings, {case.subject} against {case.other} at {case.where}"
            tests.append((above(label, saved, check.threshold * (1 - check.tolerance)), case))
    if not tests:
        found.missing.append(named(check.metric, *check.experiments))
        return
    test, best = max(tests, key=_best_first)
    for name, column in zip((best.subject, best.other), best.columns, strict=True):
        found.values[check.metric, name, best.where] = statistics.mean(column)
        _note_absent(view, best, name, found)
    yield "", test


def _note_absent(view: View, case: _Case, method: str, found: Findings) -> None:
    """Note the share of UAVs that never arrive: their times and energies are those of the whole flight."""
    arrived = view.values(case.experiment, method, "arrived", case.point)
    uavs = view.values(case.experiment, method, "uavs", case.point)
    absent = [1.0 - arrived[seed] / uavs[seed] for seed in arrived]
    if any(absent):
        share = statistics.mean(absent)
        found.values["never_arrived", method, case.where] = share
        found.remarks.append(f"{100 * share.value:.0f} % of the UAVs of {method} never arrive at {case.where}")


def _best_first(tested: tuple[Test, object]) -> tuple[int, float]:
    """Sort key: savings that hold come first, then undecided ones, so the claim fails only if all fail."""
    outcome, saved = tested[0].outcome, tested[0].estimate
    order = (Outcome.FAILS, Outcome.UNKNOWN, Outcome.UNDECIDED, Outcome.HOLDS)
    return order.index(outcome), saved.low if math.isfinite(saved.low) else -1e9 + saved.value


_KINDS: dict[str, Callable[[View, Check, Findings], Tests]] = {
    "order": _order,
    "ratio": _ratio,
    "equal": _equal,
    "bound": _bound,
    "share": _share,
    "rate": _rate,
    "trend": _trend,
    "slope": _slope,
    "point": _point,
    "best": _best,
}


def run_check(view: View, check: Check, found: Findings) -> Outcome:
    """Outcome of a check; its tests go into `found`."""
    by_place: dict[str, list[Test]] = {}
    for where, test in _KINDS[check.kind](view, check, found):
        by_place.setdefault(where, []).append(test)
        found.tests.append(test)
    places = [all_of(test.outcome for test in tests) for tests in by_place.values()]
    if not places:
        return Outcome.UNKNOWN
    return most_of(places) if check.points == "most" else all_of(places)
