"""In how many single flights a claim holds: the paper shows one, and a claim that fails on average may hold there."""

from typing import Any, cast

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
    return counted(view, claim) if has_single_flights(claim) else None


def counted(view: View, claim: Claim) -> tuple[int, int] | None:
    """The same of a claim whose checks are all of one experiment, which one flight a method decides."""
    flights, held, flown = _Flights(view), 0, 0
    for seed in view.runs.where(experiment=claim.check[0].experiment).distinct("seed"):
        found = Findings()
        for check in claim.check:
            run_check(cast(View, flights.of(seed)), check, found)
        if found.missing or not found.tests or any(test.estimate.n == 0 for test in found.tests):
            continue
        flown += 1
        held += all(test.met for test in found.tests)
    return (held, flown) if flown else None


class _Column:
    """The runs of one method, as far as one seed flew them."""

    def __init__(self, flights: "_Flights", where: tuple[str, str]) -> None:
        self._flights, self._where = flights, where

    def by_seed(self, metric: str) -> dict[int, float]:
        return self._flights.value(*self._where, metric)


class _Flights:
    """A view of one seed after another, which reads every column once: as much of `View` as such checks ask for."""

    def __init__(self, view: View) -> None:
        self._view, self._seed = view, 0
        self._read: dict[tuple[str, str, str], dict[int, float]] = {}

    def of(self, seed: int) -> "_Flights":
        """The same, now of another seed."""
        self._seed = seed
        return self

    def cell(self, experiment: str, method: str, point: float | None = None, **more: Any) -> Any:
        return _Column(self, (experiment, method))

    def value(self, experiment: str, method: str, metric: str) -> dict[int, float]:
        """The seed's value; empty if it has none."""
        key = (experiment, method, metric)
        if key not in self._read:
            self._read[key] = self._view.cell(experiment, method).by_seed(metric)
        column = self._read[key]
        return {self._seed: column[self._seed]} if self._seed in column else {}


def _is_single(check: Check) -> bool:
    return check.source == "runs" and check.experiment == "s0" and check.kind in _OF_ONE_FLIGHT
