"""Verdicts on claims, computed from the tables.

The rule, the same for every claim: a claim is **reproduced** if each of its checks holds, and a check holds if the
whole 95 % interval over seeds lies on the claimed side of its threshold. If a check can be computed and does not hold
the claim is **not reproduced**; the reason says whether the data speak against it or leave it open. It is **not
testable** if it says why no data could decide, or if the data for it are missing or come from a single seed.
Seeds are paired between methods. A best case ("up to") is the comparison with the largest lower bound, its interval
widened (Bonferroni) to hold for all comparisons at once.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from groundstation.paper import claims
from groundstation.paper.checks import Findings, Test, conjunction, named, run_check
from groundstation.paper.claims import Claim
from groundstation.paper.store import Results
from groundstation.paper.view import View

REPRODUCED, NOT_REPRODUCED, NOT_TESTABLE = "reproduced", "not reproduced", "not testable"


def judge(view: View, claim: Claim) -> dict[str, Any]:
    """The record of one claim; see `evaluate`."""
    found = Findings()
    held = [run_check(view, check, found) for check in claim.check]
    if claim.untestable:
        verdict, reason = NOT_TESTABLE, claim.untestable
    else:
        whole = conjunction(held)
        verdict = {True: REPRODUCED, False: NOT_REPRODUCED, None: NOT_TESTABLE}[whole]
        reason = _reason(verdict, found)
    return {
        "id": claim.id,
        "figure": claim.figure,
        "statement": claim.statement,
        "metric": claim.metric,
        "scenario": claim.scenario,
        "value": _plain({key: estimate.value for key, estimate in found.values.items()}),
        "ci95": _plain({key: [estimate.low, estimate.high] for key, estimate in found.values.items()}),
        "threshold": list(dict.fromkeys(test.need for test in found.tests)),
        "verdict": verdict,
        "reason": ". ".join(part.rstrip(".") for part in (reason, claim.note) if part) + ".",
        "tests": [
            {
                "what": test.what,
                "value": _number(test.estimate.value),
                "ci95": [_number(test.estimate.low), _number(test.estimate.high)],
                "seeds": test.estimate.n,
                "needs": test.need,
                "holds": test.holds,
            }
            for test in found.tests
        ],
    }


def _reason(verdict: str, found: Findings) -> str:
    tests = found.tests
    if verdict == REPRODUCED:
        failed = sum(test.holds is not True for test in tests)
        held = f"{len(tests) - failed} of {len(tests)} comparisons hold" if len(tests) > 1 else "it holds"
        return f"{held}: {_weakest(tests)}"
    if verdict == NOT_TESTABLE:
        if found.missing:
            return f"no data: {'; '.join(dict.fromkeys(found.missing[:3]))}"
        return "one seed has no interval" if tests else "no data"
    failed_tests = [test for test in tests if test.holds is False]
    contrary = [test for test in failed_tests if test.against]
    first = (contrary or failed_tests)[0]
    how = "the data speak against it" if contrary else "the data leave it open"
    count = f"{len(failed_tests)} of {len(tests)} comparisons fail; " if len(tests) > 1 else ""
    return f"{count}{how}: {first}"


def _weakest(tests: list[Test]) -> str:
    held = [test for test in tests if test.holds]
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
    """A record for every claim, in order.

    Args:
        results: the tables of the grid. measured: what `measure.measure` found; without it the claims of the
            propositions are not testable.

    Each has id, figure, statement, metric, scenario, value and ci95 (a number and its interval, or a dict of them by
    whatever tells them apart: metric, method, point of the grid), threshold (what the tests need), verdict, reason,
    and tests: every comparison with its interval, the number of seeds, and whether it holds.
    """
    view = View.of(results, measured)
    return [judge(view, claim) for claim in claims.load()]
