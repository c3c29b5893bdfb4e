"""Plans: how many flights, with how many collisions at most, show that a share of free flights reaches a target.

A plan has a number of flights n that is fixed before the first one, and a number c of flights that may fail. It accepts
if at most c of n flights fail, which is when the one-sided 95 % bound of Clopper and Pearson for c failures reaches the
target. If the true share is below the target, a plan accepts with a probability of at most 5 %.

Flights stop early only when the answer is certain: more than c of them have failed. That changes no answer, so the
level stays exact. A plan never accepts before its last flight: several looks without a correction would raise it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Literal

from scipy import special

from meanflock.results import statistics

ALPHA = 1.0 - statistics.CONFIDENCE
Answer = Literal["accepted", "rejected", "open"]


@dataclass(frozen=True)
class SamplingPlan:
    """target: share of free flights to show. failures: number c of flights that may fail. flights: their number n."""

    target: float
    failures: int
    flights: int

    def answer(self, free: Sequence[bool]) -> Answer:
        """The answer after these flights, in their order; flights beyond the plan's do not count."""
        within = free[: self.flights]
        if len(within) - sum(within) > self.failures:
            return "rejected"
        return "accepted" if len(within) == self.flights else "open"

    def acceptance(self, share: float) -> float:
        """Probability that the plan accepts, if this is the true share of free flights."""
        return float(special.bdtr(self.failures, self.flights, 1.0 - share))


def shortest(target: float, failures: int = 0) -> SamplingPlan:
    """The plan with the fewest flights that shows the target with so many failures."""
    flights = next(n for n in count(failures + 1) if special.bdtr(failures, n, 1.0 - target) <= ALPHA)
    return SamplingPlan(target, failures, flights)


def chance_of_error(policies: int) -> float:
    """Bound on the probability that a search among so many policies names one whose true share is below the target.

    Such a policy must be accepted twice, on different seeds: in the search and in the confirmation. Each happens with a
    probability of at most 5 %, so both do with at most 0.25 %, whatever the other policies did. The bound is the sum
    over the policies.
    """
    return min(1.0, policies * ALPHA * ALPHA)
