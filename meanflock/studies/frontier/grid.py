"""Flies the searches of a grid, controllers × missions × numbers of UAVs × outages, and makes the record."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec

from meanflock.results import statistics
from meanflock.studies import study
from meanflock.studies.frontier import policies
from meanflock.studies.frontier.outage import Outages
from meanflock.studies.frontier.policies import CommunicationPolicy
from meanflock.studies.frontier.record import (
    SCHEMA,
    FrontierCell,
    FrontierRecord,
    Outcomes,
    PolicyRecord,
    Reached,
    Target,
)
from meanflock.studies.frontier.sampling import SamplingPlan, chance_of_error, shortest
from meanflock.studies.frontier.search import SURVEY, FlightOutcome, PolicyFlights, Search, Stage, WantedFlights
from meanflock.studies.job_file import version
from meanflock.studies.leaderboard import flights
from meanflock.studies.leaderboard.measures import TOTAL
from meanflock.studies.leaderboard.missions import BoardMission
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.studies.runner import Jobs
from meanflock.studies.store import Store
from meanflock.swarm import __version__
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

STUDY = "frontier"
CONFIRMATION = 1000  # seeds between the first of the search and the first of the confirmation: most flights of a stage
_DIGITS = 7


class GridCell(NamedTuple):
    """A cell of the grid."""

    mission: str
    row: str
    uavs: int
    outage: float


@dataclass(frozen=True)
class _CellSearches:
    row: BoardRow
    snr_db: float
    policies: Mapping[str, CommunicationPolicy]
    first: Mapping[str, Scenario]  # by policy, with the first seed of the search
    search: Search


@dataclass(frozen=True)
class Extent:
    """The grid. uavs: numbers of UAVs. outages: of a broadcast of 64 bits. targets: shares of free flights."""

    missions: Sequence[BoardMission]
    rows: Sequence[BoardRow]
    uavs: Sequence[int]
    outages: Sequence[float]
    targets: Sequence[float]


class FrontierGrid:
    """The searches of all cells.

    Attributes:
        plans: one for each target.
        absent: reasons why rows cannot fly a mission, by mission, number of UAVs and row.
    """

    def __init__(
        self, extent: Extent, failures: int, most: int | None, first_seed: int, names: Sequence[str] = ()
    ) -> None:
        """Args:
            failures: number of flights of a plan that may fail. most: largest number of flights of a policy in a stage;
                None: those of the longest plan. names: of policies; empty for all.

        Raises:
            BadInput: a channel cannot give an outage, the file of a mission is damaged, or nothing can be flown.
        """
        self.plans = [shortest(target, failures) for target in extent.targets]
        self._most = max(plan.flights for plan in self.plans) if most is None else most
        self._first_seed, self._names = first_seed, names
        self.absent: dict[str, str] = {}
        self._cells: dict[GridCell, _CellSearches] = {}
        for mission in extent.missions:
            for uavs in extent.uavs:
                self._add(extent, mission, uavs)
        if not self._cells:
            raise BadInput(f"nothing can be flown: {'; '.join(sorted(set(self.absent.values())))}")

    def fly(self, jobs: Jobs, progress: Callable[[int, int], None], store: Store) -> FrontierRecord:
        """Fly the runs that `store` does not have, until every search has ended; see `study.fly_all`.

        `progress` is called with the number of finished runs and an estimate of all.

        Raises:
            RunFailed: interrupted, disk full or a process died; what was finished is kept.
        """
        failures: dict[GridCell, str] = {}
        while wanted := [(place, one) for place, cell in self._cells.items() for one in cell.search.wanted()]:
            points = {(place, one): self._scenarios(place, one) for place, one in wanted}
            before = sum(len(each.outcomes(stage)) for each in self._flown() for stage in ("search", "confirmation"))
            every = before + sum(cell.search.estimate() for cell in self._cells.values())

            def tell(done: int, total: int, before: int = before, every: int = every) -> None:
                progress(before + done, max(every, before + total))

            found = study.fly_all(points, jobs, tell, store, STUDY, flights.fly)
            for (place, one), results in found.items():
                self._cells[place].search.flown[one.policy].outcomes(one.stage).extend(map(outcome, results))
                failed = next((result[flights.FAILED] for result in results if flights.FAILED in result), "")
                failures[place] = failures.get(place) or failed
        return FrontierRecord(
            schema=SCHEMA,
            version=__version__,
            code=version(),
            first_seed=self._first_seed,
            confirmation_seed=self._first_seed + CONFIRMATION,
            flights=self._most,
            survey=min(SURVEY, self._most),
            targets=[Target(plan.target, plan.flights, plan.failures) for plan in self.plans],
            absent=self.absent,
            cells=[self._recorded(place, cell, failures.get(place, "")) for place, cell in self._cells.items()],
        )

    def _add(self, extent: Extent, mission: BoardMission, uavs: int) -> None:
        table = {**mission.table(), "uavs": uavs}
        thresholds: list[float] = []
        for row in extent.rows:
            where = f"{mission.name}, {uavs} UAVs, {row.name}"
            if not row.flies(mission.name):
                self.absent[where] = f"flies {', '.join(row.missions)} only"
                continue
            try:
                under = policies.of_row(row, table, mission.name, self._names)
                scenario, *_ = (
                    policy.applied_to(row).scenario(table, self._first_seed, mission.name) for policy in under
                )
            except BadInput as error:
                self.absent[where] = str(error).removeprefix(f"{mission.name}: ")
                continue
            thresholds = thresholds or [*map(Outages(scenario).snr_db, extent.outages)]
            for outage, snr_db in zip(extent.outages, thresholds, strict=True):
                place = GridCell(mission.name, row.name, uavs, outage)
                self._cells[place] = self._cell(place, row, snr_db, under, table)

    def _cell(
        self, place: GridCell, row: BoardRow, snr_db: float, under: Sequence[CommunicationPolicy], table: dict[str, Any]
    ) -> _CellSearches:
        lossy = {**table, "radio": {**table.get("radio", {}), "target_snr_db": snr_db}}
        first = {
            policy.name: policy.applied_to(row).scenario(lossy, self._first_seed, place.mission) for policy in under
        }
        search = Search(list(first), self.plans, self._most, {name: PolicyFlights() for name in first})
        return _CellSearches(row, snr_db, {policy.name: policy for policy in under}, first, search)

    def _flown(self) -> list[PolicyFlights]:
        return [flown for cell in self._cells.values() for flown in cell.search.flown.values()]

    def _scenarios(self, place: GridCell, one: WantedFlights) -> list[Scenario]:
        """The flights of a step of a search that are missing."""
        cell = self._cells[place]
        seed = self._first_seed + _offset(one.stage)
        there = len(cell.search.flown[one.policy].outcomes(one.stage))
        first = msgspec.structs.replace(cell.first[one.policy], seed=seed + there)
        return study.seeded(first, one.flights - there)

    def _recorded(self, place: GridCell, cell: _CellSearches, failure: str) -> FrontierCell:
        search = cell.search
        names = search.order()
        recorded = [
            PolicyRecord(
                name=name,
                settings=cell.policies[name].settings,
                verdicts=[search.verdict(plan, name) for plan in self.plans],
                search=_outcomes(search.flown[name].search),
                confirmation=_outcomes(search.flown[name].confirmation),
            )
            for name in names
        ]
        survey = min(SURVEY, self._most)
        tried = [policy for policy in recorded if len(policy.search.free) >= survey]
        return FrontierCell(
            mission=place.mission,
            row=place.row,
            controller=cell.row.controller,
            settings=cell.row.settings,
            yours=cell.row.yours,
            uavs=place.uavs,
            outage=place.outage,
            target_snr_db=cell.snr_db,
            error=chance_of_error(len(names)),
            policies=recorded,
            reached=[_reached(plan, search.reached(plan), search) for plan in self.plans],
            best=max(tried, key=lambda policy: (sum(policy.search.free[:survey]), len(policy.search.free))).name,
            why=failure,
        )


def outcome(result: Mapping[str, Any]) -> FlightOutcome:
    """The outcome of a flight for a search; a flight that failed is not free, and nobody arrived."""
    if flights.FAILED in result:
        return FlightOutcome(False, 0.0, 0.0)
    free = result["collisions_all"] == 0 and not result["obstacle_hits"]
    kbit = float(f"{result['bits_to_arrival'][TOTAL] / 1e3:.{_DIGITS}g}")
    return FlightOutcome(free, kbit, result["arrived"] / result["uavs"])


def _offset(stage: Stage) -> int:
    return 0 if stage == "search" else CONFIRMATION


def _outcomes(flown: Sequence[FlightOutcome]) -> Outcomes:
    return Outcomes(
        [one.free for one in flown], [one.kbit for one in flown], [round(one.arrived, _DIGITS) for one in flown]
    )


def _reached(plan: SamplingPlan, name: str | None, search: Search) -> Reached | None:
    if name is None:
        return None
    flown = search.flown[name].confirmation[: plan.flights]
    failures = sum(not flight.free for flight in flown)
    kbit = statistics.mean([flight.kbit for flight in flown])
    bound = statistics.share_at_least(len(flown) - failures, len(flown))
    return Reached(name, failures, bound, kbit.value, kbit.low, kbit.high)
