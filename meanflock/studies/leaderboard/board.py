"""The record of a leaderboard, leaderboard.json, from which its pages and pictures are made."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.results import statistics
from meanflock.results.quantities import Field
from meanflock.results.statistics import Estimate
from meanflock.studies.leaderboard import marks, rows
from meanflock.studies.leaderboard.measures import BY_KEY
from meanflock.swarm import durable, paths
from meanflock.swarm.errors import BadInput

SCHEMA = 1
FILE = "leaderboard.json"
_DIGITS = 7  # of a flight's numbers

Floats = NDArray[np.float64]

FIELDS = (  # of `leaderboard.json`: a course is a mission as flown, a standing a row of its table
    Field("schema", "1", "version of this record"),
    Field("version", "", "version of meanflock"),
    Field("code", "", "version and fingerprint of the code that flew"),
    Field("seeds", "1", "seeds of every row"),
    Field("policies", "", "policies of communication of the rows that share states; empty if each row had its own"),
    Field("courses.name", "", "name of the mission"),
    Field("courses.title", "", "heading of its table"),
    Field("courses.about", "", "description of the mission"),
    Field("courses.uavs", "UAVs", "number of UAVs"),
    Field("courses.duration_s", "s", "longest simulated time of a flight"),
    Field("courses.acceleration_max_m_s2", "m/s²", "limit of acceleration of every UAV; null: none"),
    Field("courses.absent.*", "", "reason why a row cannot fly the mission, by the row's name"),
    Field("courses.front_s", "s", "times of the front; empty if it is not known"),
    Field("courses.front_J", "J", "least energy for each of these times, mean of the UAVs"),
    Field("courses.standings.name", "", "name of the row"),
    Field("courses.standings.controller", "", "name of its controller"),
    Field("courses.standings.group", "", "group of UAVs whose flights these are; empty: all UAVs"),
    Field("courses.standings.uavs", "UAVs", "number of UAVs of the group; null: all"),
    Field("courses.standings.about", "", "description of the row"),
    Field("courses.standings.settings.*", "", "scenario keys that the row sets"),
    Field("courses.standings.yours", "", "whether the controller is from a file of the user"),
    Field("courses.standings.code", "", "version and fingerprint of the code that flew the row; empty: `code`"),
    Field("courses.standings.cells.*.mean", "", "mean of the flights, by measure; shares are of 1"),
    Field("courses.standings.cells.*.low", "", "lower end of its 95 % interval; null if there is none"),
    Field("courses.standings.cells.*.high", "", "upper end of its 95 % interval"),
    Field("courses.standings.cells.*.n", "flights", "number of these flights"),
    Field(
        "courses.standings.cells.*.best", "", "whether the row differs significantly from every other row of the table"
    ),
    Field(
        "courses.standings.cells.*.least",
        "",
        "least value of all flights; null for all measures but the closest approach",
    ),
    Field("courses.standings.kbit_by_kind.*", "kbit", "payload until the last arrival by kind of traffic, mean"),
    Field(
        "courses.standings.values.*", "", "of each measure a number a seed, in their order; null if a flight has none"
    ),
    Field("courses.standings.lost", "UAVs", "UAVs that were lost, over all flights"),
    Field("courses.standings.failed", "flights", "flights that could not be flown"),
    Field(
        "courses.standings.why",
        "",
        "reason of the first flight that failed, of the first lost UAV, or of the first failed round or training",
    ),
)


class BoardCell(msgspec.Struct, frozen=True):
    """Mean over n flights with its 95 % interval, null if there is none; best: significantly better than all other
    rows; least: of all flights.
    """

    mean: float
    low: float | None
    high: float | None
    n: int
    best: bool = False
    least: float | None = None

    @property
    def estimate(self) -> Estimate:
        """The cell as an `Estimate`."""
        low = -math.inf if self.low is None else self.low
        return Estimate(self.mean, low, math.inf if self.high is None else self.high, self.n)


class Standing(msgspec.Struct, frozen=True):
    """A row of a mission. group, uavs: the group of UAVs whose row this is, and their number; empty and None: all UAVs.
    values: of each measure, a number a seed, null if the flight has none. kbit_by_kind: mean
    payload until the last arrival, by kind. failed: number of flights that failed; why: reason of the first one, of
    the first lost UAV, or of the first round or training that failed. lost: number of lost UAVs in all flights. code:
    version and fingerprint of the code that flew it; empty: that of the board."""

    name: str
    controller: str
    about: str
    settings: dict[str, Any]
    yours: bool
    cells: dict[str, BoardCell]
    kbit_by_kind: dict[str, float]
    values: dict[str, list[float | None]]
    lost: int = 0
    failed: int = 0
    why: str = ""
    code: str = ""
    group: str = ""
    uavs: int | None = None

    @property
    def flight(self) -> str:
        """Name of the row whose flights these are; groups of one flight share it."""
        return self.name.removesuffix(f"/{self.group}") if self.group else self.name

    def column(self, key: str) -> Floats:
        """Numbers of a measure, (K,), NaN if a flight has none."""
        return np.array(self.values[key], dtype=np.float64)


class Course(msgspec.Struct, frozen=True):
    """A mission as flown. absent: rows that cannot fly it, with reasons. front_s, front_J: the least energy for a time,
    mean over the UAVs; empty if unknown."""

    name: str
    title: str
    about: str
    uavs: int
    duration_s: float
    standings: list[Standing]
    absent: dict[str, str]
    front_s: list[float]
    front_J: list[float]  # a unit
    acceleration_max_m_s2: float | None = None


class Board(msgspec.Struct, frozen=True):
    """A leaderboard. code: version and fingerprint of the code that flew. seeds: of every row. policies: policies of
    communication under which rows that share states flew; empty: each row had its own."""

    schema: int
    version: str
    code: str
    seeds: list[int]
    courses: list[Course]
    policies: list[str] = []  # msgspec copies it

    def codes(self) -> dict[str, list[str]]:
        """Names of the rows by the code that flew them, the code of most first; those of missions, if a code flew all
        rows of some missions and none of others.
        """
        flown: dict[str, list[tuple[Course, str]]] = {}
        for course in self.courses:
            for row in course.standings:
                flown.setdefault(row.code or self.code, []).append((course, row.name))
        found = {}
        for code, each in sorted(flown.items(), key=lambda entry: -len(entry[1])):
            missions = {course.name: len(course.standings) for course, _ in each}
            whole = len(self.courses) > 1 and sum(missions.values()) == len(each)
            found[code] = list(missions if whole else dict.fromkeys(name for _, name in each))
        return found

    def encode(self) -> bytes:
        """JSON, a line a row."""
        plain = msgspec.to_builtins(self)
        courses = []
        for course in plain.pop("courses"):
            rows = ",\n".join(_json(row) for row in course.pop("standings"))
            courses.append(f'{_json(course)[:-1]}, "standings": [\n{rows}\n]}}')
        return (f'{_json(plain)[:-1]}, "courses": [\n' + ",\n".join(courses) + "\n]}\n").encode()

    def write(self, out: Path) -> Path:
        """Writes it as `out`/leaderboard.json.

        Raises:
            RunFailed: the disk is full.
        """
        return durable.put(out / FILE, self.encode())


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def read(path: Path) -> Board:
    """Read a leaderboard.

    Raises:
        BadInput: the file is not a leaderboard.
    """
    try:
        return msgspec.json.decode(paths.read(path), type=Board)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give the leaderboard.json of `meanflock leaderboard`") from error
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: no leaderboard: {error}") from error


def rounded(value: float) -> float | None:
    """A number of a flight, rounded for the file; None if there is none."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


def cells(columns: dict[str, Floats]) -> dict[str, BoardCell]:
    """Cells of a row, without marks. columns: measures by key, (K,)."""
    result = {}
    for key, values in columns.items():
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        found = statistics.share(known > 0.5) if BY_KEY[key].share else statistics.mean(known)
        low, high = (found.low, found.high) if found.bounded else (None, None)
        least = float(known.min()) if BY_KEY[key].least else None
        result[key] = BoardCell(found.value, low, high, found.n, least=least)
    return result


def joined(boards: Sequence[Board]) -> Board:
    """One board of several: the missions of all, the first board's first. A row of a later board replaces that of the
    same name in the same mission; rows have the order of rows.toml, others follow.

    Raises:
        BadInput: seeds, policies, schema or the conditions of a mission differ.
    """
    first, *others = boards
    for other in others:
        for part in ("schema", "seeds", "policies"):
            if getattr(other, part) != getattr(first, part):
                raise BadInput(
                    f"boards of different {part} cannot be joined: {getattr(first, part)} and {getattr(other, part)}"
                )
    last = boards[-1]
    parts: dict[str, list[Course]] = {}
    for board in boards:
        for course in board.courses:
            same = parts.setdefault(course.name, [])
            if same and _conditions(course) != _conditions(same[0]):
                flown = f"{_conditions(same[0])} and {_conditions(course)}"
                raise BadInput(f"boards of different missions cannot be joined: {flown}")
            same.append(_coded(course, board.code, last.code))
    return remarked(msgspec.structs.replace(last, courses=list(map(_united, parts.values()))))


def _conditions(course: Course) -> tuple[str, int, float, float | None]:
    return course.name, course.uavs, course.duration_s, course.acceleration_max_m_s2


def _coded(course: Course, code: str, other: str) -> Course:
    """A mission of a board with `code`, for a board of another code."""
    by_row = [(row, row.code or code) for row in course.standings]
    standings = [msgspec.structs.replace(row, code="" if own == other else own) for row, own in by_row]
    return msgspec.structs.replace(course, standings=standings)


def _united(parts: Sequence[Course]) -> Course:
    """One mission of several boards."""
    standings: dict[str, Standing] = {}
    absent: dict[str, str] = {}
    for course in parts:
        flown = {row.name: row for row in course.standings}
        flights = {row.flight for row in course.standings}
        absent = {name: reason for name, reason in absent.items() if name not in flights} | course.absent
        standings = {name: row for name, row in standings.items() if row.flight not in course.absent} | flown
    order = [row.name for row in rows.shipped()]
    placed = sorted(standings.values(), key=lambda row: order.index(row.name) if row.name in order else len(order))
    return msgspec.structs.replace(parts[-1], standings=placed, absent=absent)


def remarked(found: Board) -> Board:
    """The same board, with new marks from the values of the flights."""
    courses = [msgspec.structs.replace(course, standings=marked(course.standings)) for course in found.courses]
    return msgspec.structs.replace(found, courses=courses)


def marked(standings: list[Standing]) -> list[Standing]:
    """The same rows with the best of each column marked, see `marks.py`.

    All rows compete for `arrived`, and those whose UAVs arrived for everything else; for energy, time, regret, effort
    and cost only if they are safe as well. `infeasible` is compared among the rows of one filter or controller.
    """
    whole = [row for row in standings if not row.failed and row.cells]
    competing = [row for row in whole if row.cells["arrived"].mean >= marks.COMPETES]
    safe = [row for row in competing if marks.is_safe(row.column("free"))]
    contests: list[marks.Contest] = []
    for key, measure in BY_KEY.items():
        if key == "infeasible":
            kinds: dict[str, list[Standing]] = {}
            for row in competing:
                kinds.setdefault(row.settings.get("filter.kind", row.controller), []).append(row)
            groups = list(kinds.values())
        else:
            groups = [whole if key == "arrived" else safe if measure.of_safe else competing]
        contests += [(measure, {row.name: row.column(key) for row in group}) for group in groups]
    best = marks.best(contests)
    return [
        msgspec.structs.replace(
            row,
            cells={key: msgspec.structs.replace(cell, best=(key, row.name) in best) for key, cell in row.cells.items()},
        )
        for row in standings
    ]
