"""The search of one cell: which policy sends the fewest bits and is shown to keep flights free of collisions.

A cell is a controller in a mission with a number of UAVs and an outage. Its search has these steps:

1. Every policy flies `PILOT` flights. Their mean payload orders the policies from cheap to dear.
2. In this order each policy flies `SURVEY` flights, whatever happens in them, so that shares of policies compare.
3. A policy goes on, `CHUNK` flights at a time, until the plan of each target accepts or rejects it. No policy is
   skipped because a cheaper or dearer one failed.
4. A policy that a plan accepted flies the same plan again on other seeds, the confirmation. If it is accepted again,
   the target is reached. If not, the search goes on with the next policy.
5. The search ends when all targets are reached, or no policy is left.

All is a function of the flights that are there, so an interrupted search goes on where it was.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from meanflock.studies.frontier.sampling import SamplingPlan

PILOT, SURVEY, CHUNK = 2, 10, 10
ARRIVES = 0.99  # least share of the UAVs that must arrive under a policy: UAVs that stay behind send less

Stage = Literal["search", "confirmation"]
STAGES: tuple[Stage, ...] = ("search", "confirmation")
Verdict = Literal["reached", "collisions", "not confirmed", "not arrived", "too few flights", "not needed", "open"]


class FlightOutcome(NamedTuple):
    """One flight. free: no collision and no hit. kbit: payload until the last arrival. arrived: share of the UAVs."""

    free: bool
    kbit: float
    arrived: float


class WantedFlights(NamedTuple):
    """Flights that a search needs next: the first `flights` seeds of a stage, under a policy."""

    policy: str
    stage: Stage
    flights: int


@dataclass
class PolicyFlights:
    """The flights of a policy, in the order of their seeds."""

    search: list[FlightOutcome] = field(default_factory=list)
    confirmation: list[FlightOutcome] = field(default_factory=list)

    def outcomes(self, stage: Stage) -> list[FlightOutcome]:
        """The flights of a stage."""
        return self.search if stage == "search" else self.confirmation


@dataclass
class Search:
    """The search of a cell.

    policies: names. plans: one a target. most: largest number of flights of a policy in a stage. flown: by policy.
    """

    policies: Sequence[str]
    plans: Sequence[SamplingPlan]
    most: int
    flown: Mapping[str, PolicyFlights]

    def wanted(self) -> list[WantedFlights]:
        """The flights that are needed next; none if the search has ended."""
        pilot = min(PILOT, self.most)
        first = [WantedFlights(name, "search", pilot) for name in self.policies if len(self.flown[name].search) < pilot]
        if first:
            return first
        survey = min(SURVEY, self.most)
        if not any(plan.flights <= self.most for plan in self.plans):
            return [
                WantedFlights(name, "search", survey) for name in self.order() if len(self.flown[name].search) < survey
            ]
        for name in self.order():
            if not self._missing(before=name):
                return []
            if len(self.flown[name].search) < survey:
                return [WantedFlights(name, "search", survey)]
            for stage in STAGES:
                flights = [self._next(plan, name, stage) for plan in self._missing(before=name)]
                if any(flights):
                    return [WantedFlights(name, stage, min(number for number in flights if number))]
        return []

    def order(self) -> list[str]:
        """The policies by the mean payload of their first flights, from cheap to dear."""
        return sorted(self.policies, key=lambda name: _kbit(self.flown[name].search[:PILOT]))

    def reached(self, plan: SamplingPlan) -> str | None:
        """The cheapest policy that reached a target; None if none has, so far."""
        return next((name for name in self.order() if self._is_reached(plan, name)), None)

    def verdict(self, plan: SamplingPlan, name: str) -> Verdict:
        """The result of a policy for a target."""
        flown = self.flown[name]
        reached = self.reached(plan)
        if reached == name:
            return "reached"
        if reached is not None and self.order().index(name) > self.order().index(reached):
            return "not needed"
        if plan.answer(_free(flown.search)) == "rejected":
            return "collisions"
        if plan.flights > self.most:
            return "too few flights"
        if plan.answer(_free(flown.search)) == "open":
            return "open"
        if not _arrives(plan, flown.search):
            return "not arrived"
        if plan.answer(_free(flown.confirmation)) == "open":
            return "open"
        return "not confirmed" if _arrives(plan, flown.confirmation) else "not arrived"

    def estimate(self) -> int:
        """Rough number of flights that are still to be flown."""
        if not self.wanted():
            return 0
        survey = min(SURVEY, self.most)
        longest = max((plan.flights for plan in self.plans if plan.flights <= self.most), default=0)
        return 2 * longest + sum(max(0, survey - len(self.flown[name].search)) for name in self.policies)

    def _missing(self, before: str) -> list[SamplingPlan]:
        """The plans within `most` that no policy cheaper than this one has satisfied."""
        order = self.order()
        cheaper = order[: order.index(before)]
        return [
            plan
            for plan in self.plans
            if plan.flights <= self.most and not any(self._is_reached(plan, name) for name in cheaper)
        ]

    def _next(self, plan: SamplingPlan, name: str, stage: Stage) -> int:
        """Number of flights to which a stage of a plan has to go on; 0 if it needs none."""
        flown = self.flown[name]
        if stage == "confirmation" and not _accepts(plan, flown.search):
            return 0
        if plan.answer(_free(flown.outcomes(stage))) != "open":
            return 0
        return min(len(flown.outcomes(stage)) + CHUNK, plan.flights)

    def _is_reached(self, plan: SamplingPlan, name: str) -> bool:
        flown = self.flown[name]
        return _accepts(plan, flown.search) and _accepts(plan, flown.confirmation)


def _accepts(plan: SamplingPlan, flights: Sequence[FlightOutcome]) -> bool:
    return plan.answer(_free(flights)) == "accepted" and _arrives(plan, flights)


def _arrives(plan: SamplingPlan, flights: Sequence[FlightOutcome]) -> bool:
    """Returns whether enough UAVs arrived in the flights of a plan."""
    within = flights[: plan.flights]
    return sum(flight.arrived for flight in within) >= ARRIVES * len(within)


def _free(flights: Sequence[FlightOutcome]) -> list[bool]:
    return [flight.free for flight in flights]


def _kbit(flights: Sequence[FlightOutcome]) -> float:
    return sum(flight.kbit for flight in flights) / len(flights)
