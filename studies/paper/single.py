"""In how many single flights a claim holds: the paper shows one, and a claim that fails on average may hold there."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import cast

from meanflock.studies.paper.checks import Findings, run_check
from meanflock.studies.paper.claims import Check, Claim
from meanflock.studies.paper.view import View

_OF_ONE_FLIGHT = frozenset({"order", "ratio", "equal", "bound", "share", "rate"})


def has_single_flights(claim: Claim) -> bool:
    """Whether one flight a method decides every check of it: it is about S0, and compares no grid."""
    return bool(claim.check) and not claim.untestable and all(map(_is_single, claim.check))


def single_flights(view: View, claim: Claim) -> tuple[int, int] | None:
    """k of n: the seeds in which every comparison of the claim comes out as claimed, and those that flew all of it.

    None where a single flight cannot decide the claim, or none was flown.
    """
    return counted(view, claim) if has_single_flights(claim) else None


def counted(view: View, claim: Claim) -> tuple[int, int] | None:
    """The same of a claim whose checks are all of one experiment, which one flight a method decides."""
    read, held, flown = cache(view.values), 0, 0  # every column once
    for seed in view.runs.where(experiment=claim.check[0].experiment).distinct("seed"):
        found = Findings()
        for check in claim.check:
            run_check(cast(View, _Flight(read, seed)), check, found)
        if found.missing or not found.tests or any(test.estimate.n == 0 for test in found.tests):
            continue
        flown += 1
        held += all(test.met for test in found.tests)
    return (held, flown) if flown else None


@dataclass
class _Flight:
    """The runs of one seed: as much of a `View` as such checks ask for."""

    read: Callable[[str, str, str], dict[int, float]]
    seed: int

    def values(self, experiment: str, method: str, metric: str, *_: object) -> dict[int, float]:
        """The seed's value; empty if it has none."""
        column = self.read(experiment, method, metric)
        return {self.seed: column[self.seed]} if self.seed in column else {}


def _is_single(check: Check) -> bool:
    return check.source == "runs" and check.experiment == "s0" and check.kind in _OF_ONE_FLIGHT
