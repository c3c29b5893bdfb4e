"""Flies a leaderboard, missions × rows × seeds, and makes the board."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from meanflock.studies import study
from meanflock.studies.failure_reasons import FAILURES
from meanflock.studies.job_file import version
from meanflock.studies.leaderboard import flights
from meanflock.studies.leaderboard.board import SCHEMA, Board, Course, Standing, cells, marked, rounded
from meanflock.studies.leaderboard.front import Fronts
from meanflock.studies.leaderboard.measures import BY_KEY, TOTAL, of_flight
from meanflock.studies.leaderboard.missions import BoardMission
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.studies.lent_radio import LentRadio
from meanflock.studies.runner import Jobs
from meanflock.studies.store import Store
from meanflock.swarm import __version__, toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.mission import obstacles, parts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.scenario.tables import Sharing

Points = dict[tuple[str, str], list[Scenario]]  # mission and row → a scenario a seed
DEFAULT_POLICY = Sharing().policy
_FRONT_POINTS = 60  # of the line in a picture
_FASTEST = 4.0  # times faster than the flight of least energy: where that line begins


class Contest:
    """Flights of a leaderboard.

    Attributes:
        points: scenarios, one for each seed, by mission and row.
        absent: rows that cannot fly a mission, with reasons, by mission.
    """

    def __init__(
        self,
        missions: Sequence[BoardMission],
        rows: Sequence[BoardRow],
        seeds: int,
        first_seed: int,
        policies: Sequence[str] = (DEFAULT_POLICY,),
        learner: str | None = None,
        radio: LentRadio | None = None,
    ) -> None:
        """
        Args:
            policies: policies of communication under which rows that share states fly.
            learner: name of a learner that trains in every flight. Rows that share a model of their own are absent.
            radio: flown in every mission in place of its own.

        Raises:
            BadInput: the file of a mission is damaged, a shipped row is invalid, or nothing can be flown.
        """
        self._missions, self._policies, self._radio = missions, list(policies), radio
        self._rows: dict[str, list[BoardRow]] = {mission.name: [] for mission in missions}
        self._seeds = list(range(first_seed, first_seed + seeds))
        self.points: Points = {}
        self.absent: dict[str, dict[str, str]] = {}
        for mission in missions:
            table, self.absent[mission.name] = mission.table(), {}
            for setting in () if radio is None else radio.settings:
                toml.apply(table, setting)
            own = mission.own_row()
            for row in rows if own is None else (own,):
                if not row.flies(mission.name):
                    self.absent[mission.name][row.name] = f"flies {', '.join(row.missions)} only"
                    continue
                try:
                    flown = row if learner is None else row.training(learner, table, mission.name)
                    under = flown.under(policies, table, mission.name)
                    first = [each.scenario(table, first_seed, mission.name) for each in under]
                except BadInput as error:
                    self.absent[mission.name][row.name] = str(error).removeprefix(f"{mission.name}: ")
                    continue
                self._rows[mission.name] += under
                for each, scenario in zip(under, first, strict=True):
                    self.points[mission.name, each.name] = study.seeded(scenario, seeds)
        if not self.points:
            reasons = {reason for left in self.absent.values() for reason in left.values()}
            raise BadInput(f"nothing can be flown: {'; '.join(sorted(reasons))}")

    def fly(self, jobs: Jobs, progress: Callable[[int, int], None], store: Store) -> Board:
        """Fly the runs that `store` does not have; see `study.fly_all`.

        Raises:
            RunFailed: interrupted, disk full or a process died; what was finished is kept.
        """
        flown = study.fly_all(self.points, jobs, progress, store, flights.STUDY, flights.fly)
        courses = [self._course(mission, flown) for mission in self._missions]
        return Board(SCHEMA, __version__, version(), self._seeds, courses, self._policies)

    def _course(self, mission: BoardMission, flown: Mapping[tuple[str, str], study.Summaries]) -> Course:
        flying = self._rows[mission.name]
        standings: list[Standing] = []
        line: tuple[list[float], list[float]] = [], []
        uavs = 0
        duration = 0.0
        limit = None
        for row in flying:
            scenario = self.points[mission.name, row.name][0]
            standings += _standings(row, mission, scenario, flown[mission.name, row.name])
            line = line if line[0] else _line(scenario)
            uavs, duration = scenario.uavs, scenario.duration
            limit = scenario.vehicle.acceleration_max
        return Course(
            name=mission.name,
            title=mission.title or mission.name,
            about=mission.about if self._radio is None else f"{mission.about} Radio of {self._radio.name}.".strip(),
            uavs=uavs,
            duration_s=duration,
            acceleration_max_m_s2=limit,
            standings=marked(standings),
            absent=self.absent[mission.name],
            front_s=line[0],
            front_J=line[1],
        )


def _standings(row: BoardRow, mission: BoardMission, scenario: Scenario, flown: study.Summaries) -> Iterator[Standing]:
    """The standing of a row, or one for each group of its UAVs, named ROW/GROUP."""
    if not scenario.groups:
        yield _standing(row, mission, Fronts(scenario), flown)
    for group, rows in parts(scenario):
        of_group = scenario.of_group(group)
        results = [flights.of_group(result, group.name, rows) for result in flown]
        whole = _standing(row, mission, Fronts(of_group, rows), results)
        yield msgspec.structs.replace(
            whole, name=f"{row.name}/{group.name}", controller=of_group.method, group=group.name, uavs=group.count
        )


def _standing(row: BoardRow, mission: BoardMission, fronts: Fronts, flown: study.Summaries) -> Standing:
    nothing = dict.fromkeys(BY_KEY, np.nan)
    discs = len(obstacles(fronts.scenario))
    numbers = [
        nothing
        if flights.FAILED in result
        else of_flight(result, fronts.regret(result), mission.time_price_W, discs > 0)
        for result in flown
    ]
    columns = {key: np.array([each[key] for each in numbers]) for key in BY_KEY}
    whole = [result for result in flown if flights.FAILED not in result]
    failed = [result[flights.FAILED] for result in flown if flights.FAILED in result]
    reasons = [*failed, *(reason for result in whole for reason in result[FAILURES])]
    return Standing(
        name=row.name,
        controller=row.controller,
        about=row.about,
        settings=row.settings,
        yours=row.yours,
        cells=cells(columns),
        kbit_by_kind=_by_kind(whole),
        values={key: [rounded(value) for value in values.tolist()] for key, values in columns.items()},
        lost=sum(result["lost"] for result in whole),
        failed=len(failed),
        why=next(iter(reasons), ""),
    )


def _by_kind(flown: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Mean payload until the last arrival, kbit, of the kinds that were sent."""
    sent = (result["bits_to_arrival"].items() for result in flown)
    kinds = dict.fromkeys(kind for each in sent for kind, bits in each if bits and kind != TOTAL)
    return {kind: float(np.mean([result["bits_to_arrival"][kind] for result in flown])) / 1e3 for kind in kinds}


def _line(scenario: Scenario) -> tuple[list[float], list[float]]:
    """The front for a picture, up to the duration. Groups have different ones, so there is no line for all rows."""
    if scenario.groups:
        return [], []
    fronts = Fronts(scenario)
    times = np.geomspace(1.0, scenario.duration, 400)
    least = fronts.mean(times)
    if least is None:
        return [], []
    slowest = times[int(np.nanargmin(least))]
    shown = np.geomspace(slowest / _FASTEST, scenario.duration, _FRONT_POINTS)
    energies = fronts.mean(shown)
    assert energies is not None
    known = np.isfinite(energies)
    return shown[known].round(3).tolist(), energies[known].round(5).tolist()
