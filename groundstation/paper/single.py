"""In how many single flights a claim holds: the paper shows one, and a claim that fails on average may hold there."""

from meanflock.groundstation.paper.checks import Findings, run_check
from meanflock.groundstation.paper.claims import Check, Claim
from meanflock.groundstation.paper.view import View

_OF_ONE_FLIGHT = frozenset({"order", "ratio", "equal", "bound", "share", "rate"})


def has_single_flights(claim: Claim) -> bool:
    """Whether one flight a method decides every check of it: it is about S0, and compares no grid."""
    return bool(claim.check) and not claim.untestable and all(map(_is_single, claim.check))


def single_flights(view: View, claim: Claim) -> tuple[int, int] | None:
    """k of n: the seeds in which every comparison of the claim comes out as claimed, and those that flew all of it.

    None where a single flight cannot decide the claim, or none was flown.
    """
    if not has_single_flights(claim):
        return None
    held = flown = 0
    for seed in view.runs.where(experiment="s0").distinct("seed"):
        one, found = View(view.runs.where(seed=seed), view.series, view.trajectories, view.weights, {}), Findings()
        for check in claim.check:
            run_check(one, check, found)
        if found.missing or not found.tests or any(test.estimate.n == 0 for test in found.tests):
            continue
        flown += 1
        held += all(test.met for test in found.tests)
    return (held, flown) if flown else None


def _is_single(check: Check) -> bool:
    return check.source == "runs" and check.experiment == "s0" and check.kind in _OF_ONE_FLIGHT
