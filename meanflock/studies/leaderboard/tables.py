"""Cells and texts of a mission's table, for Markdown, HTML and the terminal."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from meanflock.studies.leaderboard.board import Board, BoardCell, Course, Standing
from meanflock.studies.leaderboard.measures import MEASURES, Measure
from meanflock.swarm import toml

_PER_CENT = ("arrived", "free")
# Columns for which a terminal of 80 columns has room.
SHORT = ("arrived", "time_s", "energy_J", "regret_J", "cost_J", "collisions_all", "closest_m", "free", "kbit")
MAP = "{}: map of the mission"  # words instead of a picture
PLOTS = "{}: time and energy, bits and collisions"
OVERVIEW = (
    "Share of flights without any collision or hit, %, arrived UAVs included; bold: all flights. Intervals and "
    "costs are in the table of each mission."
)
HOW_TO_READ = (
    "Means over n flights with the 95 % interval over seeds: mean ± half its width (Student's t); for the share of "
    "flights without a collision its ends (Clopper and Pearson). A UAV that never arrived counts with the duration and "
    "with all its energy. **Bold**: significantly different from every other row of the table, paired by seed and "
    "corrected after Holm, so that a table contains a wrong mark with a probability of at most 5 %. Rows in which "
    "fewer than 99 % of the UAVs arrived are compared by arrivals only. Time, energy, regret, cost and effort are "
    "compared only among safe rows: the one-sided 95 % bound of their free flights is at least 90 %, which takes 30 of "
    "30. *Infeasible* is compared only among rows of one filter or controller. In the pictures a row has the "
    "number of its place in the table, and a family of rows has one colour."
)


class Text(NamedTuple):
    """A cell in words; best: it is marked."""

    text: str
    best: bool = False


def measures(course: Course) -> list[Measure]:
    """The columns of a mission, without optional ones that no row has."""
    return [
        measure
        for measure in MEASURES
        if not measure.optional or any(measure.key in row.cells for row in course.standings)
    ]


def conditions(course: Course, policies: Sequence[str]) -> str:
    """Conditions of all rows of a mission: number of UAVs, limit of acceleration, policy of communication.

    Empty if no row flew it.
    """
    if not course.standings:
        return ""
    parts = [f"{course.uavs} UAVs."]
    if course.acceleration_max_m_s2 is not None:
        parts.append(f"Acceleration is limited to {course.acceleration_max_m_s2:g} m/s².")
    if len(policies) == 1:
        parts.append(f"UAVs that share states do so by policy `{policies[0]}`.")
    elif policies:
        parts.append("UAVs that share states do so by the policy in the row's name.")
    return " ".join(parts)


def has_groups(course: Course) -> bool:
    """Returns whether any row of a mission is that of a group of UAVs."""
    return any(row.group for row in course.standings)


def head(course: Course) -> list[str]:
    """The headings of a mission's table."""
    return [
        "row",
        *(["UAVs"] if has_groups(course) else []),
        "n",
        *(measure.titled for measure in measures(course)),
        "radio by kind, kbit",
    ]


def body(course: Course) -> list[list[Text]]:
    """Its rows, cell by cell."""
    rows = []
    for row in course.standings:
        flown = max((cell.n for cell in row.cells.values()), default=0)
        uavs = [Text(str(row.uavs or course.uavs))] if has_groups(course) else []
        line = [Text(row.name), *uavs, Text(str(flown))]
        for measure in measures(course):
            cell = row.cells.get(measure.key)
            line.append(Text("–") if cell is None else Text(words(measure, cell, flown), cell.best))
        rows.append([*line, Text(kinds(row))])
    return rows


def words(measure: Measure, cell: BoardCell, flown: int) -> str:
    """`9.08 ± 0.01`, `100 (88…100)` of a share, `0.61 ± 0.02 (least 0.44)`; n if it differs from that of the row."""
    scale = 100.0 if measure.key in _PER_CENT else 1.0
    if measure.share and cell.low is not None and cell.high is not None:
        text = f"{scale * cell.mean:.0f} ({scale * cell.low:.0f}…{scale * cell.high:.0f})"
    elif cell.low is None or cell.high is None:
        text = f"{scale * cell.mean:.4g}"
    else:
        half = scale * (cell.high - cell.low) / 2
        digits = _digits(scale * cell.mean, half)
        text = f"{scale * cell.mean:,.{digits}f} ± {half:,.{digits}f}"
    if cell.least is not None:
        text += f" (least {cell.least:.2f})"
    return text if cell.n == flown else f"{text}, n = {cell.n}"


def mean(measure: Measure, cell: BoardCell | None) -> str:
    """The mean alone, in three digits."""
    if cell is None:
        return "–"
    value = (100.0 if measure.key in _PER_CENT else 1.0) * cell.mean
    if abs(value) >= 100.0 or value == 0.0:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 0.1 else f"{value:.3f}"


def overview(board: Board) -> tuple[list[str], list[list[Text]]]:
    """Share of flights free of any collision or hit, of every row in every mission, %; marked if all were."""
    lines = []
    for name in dict.fromkeys(row.name for course in board.courses for row in course.standings):
        line = [Text(name)]
        for course in board.courses:
            cell = next((row.cells.get("free") for row in course.standings if row.name == name), None)
            line.append(Text("–") if cell is None else Text(f"{100 * cell.mean:.0f}", cell.mean == 1.0))
        lines.append(line)
    return ["row", *(course.name for course in board.courses)], lines


def kinds(row: Standing) -> str:
    """`state 120, uplink 3.1`."""
    return ", ".join(f"{kind} {kbit:,.{0 if kbit >= 100 else 1}f}" for kind, kbit in row.kbit_by_kind.items()) or "–"


def mixed(course: Course) -> list[str]:
    """A line about the payload of each row that has several kinds of traffic."""
    return [f"{row.name}, radio by kind, kbit: {kinds(row)}" for row in course.standings if len(row.kbit_by_kind) > 1]


def notes(course: Course) -> list[str]:
    """Notes on rows: failed flights, lost UAVs, failed rounds and trainings, global random numbers, missing rows."""
    remarks = []
    for row in course.standings:
        if row.failed:
            remarks.append(f"{row.name}: {row.failed} of {len(row.values['time_s'])} flights failed: {row.why}")
        elif row.lost:
            remarks.append(
                f"{row.name}: UAVs lost in all flights: {row.lost}; the first: {row.why or 'by the fault script'}"
            )
        elif row.why and not row.group:  # groups share the reasons of their flights
            remarks.append(f"{row.name}: rounds, trainings or random numbers went wrong; the first: {row.why}")
    return remarks + not_flown(course.absent, ", ")


def not_flown(absent: Mapping[str, str], separator: str) -> list[str]:
    """Remarks on what did not fly, one for each reason. `absent`: name → reason."""
    by_reason: dict[str, list[str]] = {}
    for name, reason in absent.items():
        by_reason.setdefault(reason, []).append(name)
    return [f"not flown: {separator.join(names)} ({reason})" for reason, names in by_reason.items()]


def settings(rows: Sequence[Standing]) -> list[list[str]]:
    """Name, controller with settings, and description of each row."""
    return [
        [
            row.name,
            " ".join([row.controller, *(f"{key}={_toml(value)}" for key, value in row.settings.items())]),
            "yours" if row.yours and not row.about else row.about,
        ]
        for row in rows
    ]


def _toml(value: object) -> str:
    return value if isinstance(value, str) else toml.inline(value)


def _digits(mean: float, half: float) -> int:
    """Decimals that show two digits of the interval; of a number without one, four digits."""
    size = half if half > 0 else abs(mean) / 100
    return min(4, max(0, 1 - math.floor(math.log10(size)))) if size > 0 else 0
