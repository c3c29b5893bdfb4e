"""Verdicts on claims, computed from the tables by one rule for all: `report/claims.py` words it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from meanflock.studies.paper import claims
from meanflock.studies.paper.checks import Findings, named, run_check
from meanflock.studies.paper.claims import Claim
from meanflock.studies.paper.outcome import Outcome, Test, all_of
from meanflock.studies.paper.single import single_flights
from meanflock.studies.paper.tables import Results
from meanflock.studies.paper.view import View

REPRODUCED, BY_CONSTRUCTION, NOT_REFUTED = "reproduced", "reproduced, by construction", "not refuted"
NOT_REPRODUCED, UNDECIDED, NOT_TESTABLE = "not reproduced", "undecided", "not testable"
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
                "what": test.what,
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
    """Keys without the parts all have in common; a lone value without any key. Infinite and NaN become None."""

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
    view = View.of(results, measured)
    return [judge(view, claim) for claim in (*claims.load(), *claims.own())]
