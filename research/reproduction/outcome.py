"""Comparison of an estimate with a threshold: its whole 95 % interval decides the outcome."""

import enum
import math
import operator
from collections.abc import Iterable
from dataclasses import dataclass

from meanflock.results.statistics import Estimate


class Outcome(enum.StrEnum):
    """Outcome of a comparison, of a check or of all checks of a claim."""

    HOLDS = "holds"  # the whole interval lies on the claimed side of the threshold
    FAILS = "fails"  # the whole interval lies on the other side
    UNDECIDED = "undecided"  # the interval has the threshold in it
    UNKNOWN = "unknown"  # there is no interval: no data, or a single seed


@dataclass(frozen=True, slots=True)
class Test:
    """An estimate that should lie in [floor, ceiling]; strict excludes the ends."""

    label: str
    estimate: Estimate
    need: str
    outcome: Outcome
    floor: float = -math.inf
    ceiling: float = math.inf
    strict: bool = False

    @property
    def met(self) -> bool:
        """Returns whether the value itself, without its interval, lies in the range."""
        value = self.estimate.value
        return self.floor < value < self.ceiling if self.strict else self.floor <= value <= self.ceiling

    def __str__(self) -> str:
        return f"{self.label} = {show(self.estimate)}, needs {self.need}"


def number(value: float | None) -> str:
    """The number with three digits, or all digits before the point; ? if it is None."""
    if value is None:
        return "?"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"


def show(estimate: Estimate) -> str:
    """`1.23 [1.10, 1.36]`."""
    return f"{number(estimate.value)} [{number(estimate.low)}, {number(estimate.high)}]"


def below(label: str, estimate: Estimate, limit: float, strict: bool = False) -> Test:
    """Holds if the whole interval is ≤ `limit` (< if strict), fails if all of it is not."""
    return _judge(label, estimate, f"{'<' if strict else '≤'} {limit:.4g}", -math.inf, limit, strict)


def above(label: str, estimate: Estimate, limit: float, strict: bool = False) -> Test:
    """Holds if the whole interval is ≥ `limit` (> if strict), fails if all of it is not."""
    return _judge(label, estimate, f"{'>' if strict else '≥'} {limit:.4g}", limit, math.inf, strict)


def within(label: str, estimate: Estimate, low: float, high: float) -> Test:
    """Holds if the whole interval lies in [low, high], fails if all of it lies outside on one side."""
    return _judge(label, estimate, f"in [{low:.4g}, {high:.4g}]", low, high, strict=False)


def _judge(label: str, estimate: Estimate, need: str, floor: float, ceiling: float, strict: bool) -> Test:
    # An end that is infinite is no threshold: nothing lies on it.
    over, under = (operator.lt if strict and math.isfinite(end) else operator.le for end in (floor, ceiling))
    if math.isnan(estimate.value) or (estimate.n < 2 and estimate.low != estimate.high):
        outcome = Outcome.UNKNOWN
    elif over(floor, estimate.low) and under(estimate.high, ceiling):
        outcome = Outcome.HOLDS
    elif over(floor, estimate.high) and under(estimate.low, ceiling):
        outcome = Outcome.UNDECIDED
    else:
        outcome = Outcome.FAILS
    return Test(label, estimate, need, outcome, floor, ceiling, strict)


_WORST_FIRST = (Outcome.FAILS, Outcome.UNDECIDED, Outcome.UNKNOWN)


def all_of(outcomes: Iterable[Outcome]) -> Outcome:
    """The worst outcome: fails, else undecided, else unknown, else holds."""
    seen = set(outcomes)
    return next((outcome for outcome in _WORST_FIRST if outcome in seen), Outcome.HOLDS)


def most_of(outcomes: Iterable[Outcome]) -> Outcome:
    """Outcome of a majority: fails if half or more fail, because open outcomes could not change it."""
    seen = list(outcomes)
    held, undecided = seen.count(Outcome.HOLDS), seen.count(Outcome.UNDECIDED)
    if 2 * held > len(seen):
        return Outcome.HOLDS
    if 2 * (len(seen) - seen.count(Outcome.FAILS)) <= len(seen):
        return Outcome.FAILS
    return Outcome.UNDECIDED if undecided else Outcome.UNKNOWN
