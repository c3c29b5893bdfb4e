"""Verdicts on claims: over all flights, in single flights, and in other settings of the free parameters."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import pyarrow as pa
import pyarrow.compute as pc

from research.reproduction import claims
from research.reproduction.checks import Findings, named, run_check
from research.reproduction.claims import Check, Claim
from research.reproduction.outcome import Outcome, Test, all_of
from research.reproduction.tables import Results, View

# -- single flights ----------------------------------------------------------------------------------------------------


_OF_ONE_FLIGHT = frozenset({"order", "ratio", "equal", "bound", "share", "rate"})


def has_single_flights(claim: Claim) -> bool:
    """Returns whether one flight of each method decides all checks: they are about S0 and use no grid."""
    return bool(claim.check) and not claim.untestable and all(map(_is_single, claim.check))


def single_flights(view: View, claim: Claim) -> tuple[int, int] | None:
    """k of n: the seeds in which every comparison meets the claim, and the seeds with all its data.

    None if a single flight cannot decide the claim, or there is no flight.
    """
    return counted(view, claim) if has_single_flights(claim) else None


def counted(view: View, claim: Claim) -> tuple[int, int] | None:
    """`single_flights` of a claim whose checks all use one experiment."""
    read = cache(view.values)  # every column once
    held = 0
    flown = 0
    for seed in view.runs.where(experiment=claim.check[0].experiment).distinct("seed"):
        found = Findings()
        for check in claim.check:
            run_check(cast(View, _SeedRuns(read, seed)), check, found)
        if found.missing or not found.tests or any(test.estimate.n == 0 for test in found.tests):
            continue
        flown += 1
        held += all(test.met for test in found.tests)
    return (held, flown) if flown else None


@dataclass
class _SeedRuns:
    """The runs of one seed, with the part of a `View` that these checks use."""

    read: Callable[[str, str, str], dict[int, float]]
    seed: int

    def values(self, experiment: str, method: str, metric: str, *_: object) -> dict[int, float]:
        """The seed's value; empty if it has none."""
        column = self.read(experiment, method, metric)
        return {self.seed: column[self.seed]} if self.seed in column else {}


def _is_single(check: Check) -> bool:
    return check.source == "runs" and check.experiment == "s0" and check.kind in _OF_ONE_FLIGHT


# -- verdicts ----------------------------------------------------------------------------------------------------------


REPRODUCED = "reproduced"
BY_CONSTRUCTION = "reproduced, by construction"
NOT_REFUTED = "not refuted"
NOT_REPRODUCED = "not reproduced"
UNDECIDED = "undecided"
NOT_TESTABLE = "not testable"
VERDICTS = (REPRODUCED, BY_CONSTRUCTION, NOT_REFUTED, NOT_REPRODUCED, UNDECIDED, NOT_TESTABLE)
OF_OUTCOME = {
    Outcome.HOLDS: REPRODUCED,
    Outcome.FAILS: NOT_REPRODUCED,
    Outcome.UNDECIDED: UNDECIDED,
    Outcome.UNKNOWN: NOT_TESTABLE,
}
# Verdicts on claims that hold because their checks can hardly fail: never plainly "reproduced".
HOLDS_ANYWAY = {"by construction": BY_CONSTRUCTION, "no divergence": NOT_REFUTED}
HOLDING = frozenset({REPRODUCED, *HOLDS_ANYWAY.values()})


def judge(view: View, claim: Claim) -> dict[str, Any]:
    """The record of one claim; see `evaluate`."""
    found, flights = Findings(), single_flights(view, claim)
    outcomes = [run_check(view, check, found) for check in claim.check]
    if claim.untestable:
        verdict, reason = NOT_TESTABLE, claim.untestable
    else:
        outcome = all_of(outcomes)
        if outcome is Outcome.UNKNOWN and Outcome.HOLDS in outcomes:  # one check is left open: so is the claim
            outcome = Outcome.UNDECIDED
        verdict = OF_OUTCOME[outcome]
        if outcome is Outcome.HOLDS:
            verdict = HOLDS_ANYWAY.get(claim.kind, REPRODUCED)
        reason = _reason(verdict, found)
    return {
        "id": claim.id,
        "figure": claim.figure,
        "statement": claim.statement,
        "metric": claim.metric,
        "scenario": claim.scenario,
        "kind": claim.kind,
        "single_flights": None if flights is None else list(flights),
        "value": _plain({key: estimate.value for key, estimate in found.values.items()}),
        "ci95": _plain({key: [estimate.low, estimate.high] for key, estimate in found.values.items()}),
        "threshold": list(dict.fromkeys(test.need for test in found.tests)),
        "verdict": verdict,
        "reason": ". ".join(part.rstrip(".") for part in (reason, *found.remarks, claim.note) if part) + ".",
        "tests": [
            {
                "what": test.label,
                "value": _number(test.estimate.value),
                "ci95": [_number(test.estimate.low), _number(test.estimate.high)],
                "seeds": test.estimate.n,
                "needs": test.need,
                "outcome": str(test.outcome),
            }
            for test in found.tests
        ],
    }


def _reason(verdict: str, found: Findings) -> str:
    tests = found.tests
    if verdict == NOT_TESTABLE:
        if found.missing:
            return f"no data: {'; '.join(dict.fromkeys(found.missing[:3]))}"
        return "one seed has no interval" if tests else "no data"
    by_outcome = {outcome: [test for test in tests if test.outcome is outcome] for outcome in Outcome}
    held, failed, open_ = (by_outcome[outcome] for outcome in (Outcome.HOLDS, Outcome.FAILS, Outcome.UNDECIDED))
    if verdict in HOLDING:
        count = f"{len(held)} of {len(tests)} comparisons hold" if len(tests) > 1 else "it holds"
        return f"{count}: {_weakest(held)}"
    shares = [f"{len(failed)} of {len(tests)} comparisons fail"] if failed else []
    if open_:
        shares.append(
            f"{len(open_)} undecided" if failed else f"{len(open_)} of {len(tests)} comparisons are undecided"
        )
    count = f"{', '.join(shares)}; " if len(tests) > 1 else ""
    if verdict == UNDECIDED and not open_:
        lacking = "; ".join(dict.fromkeys(found.missing[:3]))
        return f"{len(held)} of {len(tests)} comparisons hold; of others there are no data: {lacking}"
    if verdict == UNDECIDED:
        return f"{count}the data leave it open: {open_[0]}"
    return f"{count}the data speak against it: {failed[0]}"


def _weakest(held: list[Test]) -> str:
    return str(max(held, key=lambda test: (test.estimate.high - test.estimate.low) / (abs(test.estimate.value) or 1.0)))


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(values: dict[tuple[str, str, str], Any]) -> Any:
    """Values under the parts of their keys that differ; a single value without a key. Infinity and NaN become None."""

    def clean(value: Any) -> Any:
        return [_number(end) for end in value] if isinstance(value, list) else _number(value)

    if not values:
        return None
    differs = [len({key[k] for key in values}) > 1 for k in range(3)]
    if not any(differs):
        return clean(next(iter(values.values())))
    flat = {}
    for key, value in values.items():
        flat[named(*(part for part, differ in zip(key, differs, strict=True) if differ))] = clean(value)
    return flat


def evaluate(results: Results, measured: Mapping[str, Sequence[float]] | None = None) -> list[dict[str, Any]]:
    """A record for every claim of the paper, in order, and then of our own.

    Args:
        results: the tables of the grid. measured: what `measure.measure` found; without it the claims of the
            propositions are not testable.

    Each has id, figure, statement, metric, scenario, kind (see `claims.Claim`), single_flights ([k, n]: it holds in
    k of n, or None where one flight cannot say), value and ci95 (a number and its interval, or a dict of them by
    whatever tells them apart: metric, method, point of the grid), threshold (what the tests need), verdict, reason,
    and tests: every comparison with its interval, the number of seeds, and its outcome: holds, fails, undecided or
    unknown.
    """
    view = View.from_results(results, measured)
    return [judge(view, claim) for claim in (*claims.load(), *claims.own())]


# -- other settings ----------------------------------------------------------------------------------------------------


EXPERIMENTS = ("sensitivity", "random")


@dataclass(frozen=True)
class Share:
    """Verdicts on one claim in all settings.

    holds, undecided, against: number of settings with that verdict. kept_by: settings in which it holds.
    """

    id: str
    holds: int
    undecided: int
    against: int
    kept_by: tuple[str, ...]

    @property
    def settings(self) -> int:
        """Number of settings with a verdict."""
        return self.holds + self.undecided + self.against


def shares(results: Results) -> list[Share]:
    """The share of every claim that at least one setting can decide, in the order of the claims."""
    settings = _settings(results.runs)
    views = {setting: View.from_results(of_setting(results, EXPERIMENTS, setting)) for setting in settings}
    table = []
    for claim in claims.load():
        if claim.untestable or not claim.scenario.startswith("S0"):
            continue
        judged = {setting: judge(view, claim) for setting, view in views.items()}
        verdicts = [record["verdict"] for record in judged.values()]
        if all(verdict == NOT_TESTABLE for verdict in verdicts):
            continue
        holding = tuple(setting for setting, record in judged.items() if record["verdict"] in HOLDING)
        table.append(Share(claim.id, len(holding), verdicts.count(UNDECIDED), verdicts.count(NOT_REPRODUCED), holding))
    return table


def _settings(runs: pa.Table) -> list[str]:
    own = runs.filter(pc.is_in(runs["experiment"], pa.array(EXPERIMENTS)))
    return list(dict.fromkeys(own["setting"].to_pylist()))


def of_setting(results: Results, experiments: Sequence[str], setting: str) -> Results:
    """The runs and paths of one setting in some experiments, with the coordinates of S0."""
    return Results(
        runs=_as_s0(results.runs, experiments, setting),
        series=results.series.slice(0, 0),
        trajectories=_as_s0(results.trajectories, experiments, setting),
        weights=results.weights.slice(0, 0),
    )


def _as_s0(rows: pa.Table, experiments: Sequence[str], setting: str) -> pa.Table:
    own = pc.and_(pc.is_in(rows["experiment"], pa.array(experiments)), pc.equal(rows["setting"], setting))
    rows = rows.filter(own)
    for name, value in (("experiment", "s0"), ("setting", "")):
        place = rows.schema.get_field_index(name)
        column = pa.array([value] * rows.num_rows).cast(rows.schema.field(name).type)
        rows = rows.set_column(place, rows.schema.field(name), column)
    return rows
