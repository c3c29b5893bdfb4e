"""The pictures of a mission: time and energy with the front, and bits and collisions; a numbered point a row.

The number of a row is its place in the mission's table. A family of rows has one colour and one marker.
"""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator
from numpy.typing import NDArray

from meanflock.results.plots import plotstyle
from meanflock.results.plots.comparison import explained
from meanflock.studies.leaderboard import labels, rows
from meanflock.studies.leaderboard.board import BoardCell, Course, Standing
from meanflock.studies.leaderboard.labels import Block, Numbered
from meanflock.studies.leaderboard.marks import COMPETES


class FamilyLook(NamedTuple):
    """Colour, marker and its size of a family."""

    colour: str
    marker: str
    size: float = 4.5


# Okabe and Ito's colours, the light ones darker, so that digits can be read.
LOOKS = {
    "paper": FamilyLook("#0072B2", "o"),
    "without radio": FamilyLook("#6E6E6E", "s", 4.2),
    "classics": FamilyLook("#D55E00", "^", 5.0),
    "planners": FamilyLook("#007A5A", "D", 4.0),
    "learners": FamilyLook("#B0478A", "v", 5.0),
    "wind": FamilyLook("#B07A00", "P", 5.2),
    "policy": FamilyLook("#5B3A9E", "X", 5.2),
}
OTHERS, YOURS = "others", "yours"  # families of rows that rows.toml does not have
LOOKS |= {OTHERS: FamilyLook("#222222", "p", 5.0), YOURS: FamilyLook("#CC2222", "*", 11.0)}
_WIDTH_IN, _HEIGHT_IN, _CAPTION_IN = 9.6, 5.2, 0.2
_LINE_IN, _NAME_PT, _LETTER_IN = 0.128, 6.8, 0.058  # of the legend: height of a line, size and width of a letter
_LEADS = (
    (1, 2, 3, 5),
    (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9),
)  # leading digits of the numbers at an axis; the shortest list that suffices is used
_LEAST_NUMBERS = 2  # least numbers at an axis
_TICKS = 100  # of an axis, at the most
_LEAST_KBIT, _LEAST_PAIRS = 1.0, 0.1  # below, the axes are linear, so that nothing has a place


Keys = tuple[str, str]  # measures across and up


class NumberedRow(NamedTuple):
    """A row in a picture, with its number."""

    number: int
    row: Standing
    family: str

    @property
    def look(self) -> FamilyLook:
        """Look of its family."""
        return LOOKS[self.family]


def draw(course: Course) -> Figure:
    """Both plots of a mission, side by side, and the names of the numbers."""
    points = shown(course)
    with plotstyle.style():
        width = _legend_in(points)
        figure = plotstyle.figure(_WIDTH_IN, _HEIGHT_IN + _CAPTION_IN)
        left, right, names = figure.subplots(1, 3, width_ratios=[1.0, 1.0, width / (_WIDTH_IN - width) * 2.0])
        _time_energy(left, course, points)
        _bits_collisions(right, points)
        _legend(names, points, bool(course.front_s))
        explained(figure, [max(cell.n for cell in point.row.cells.values()) for point in points])
        figure.draw_without_rendering()
        front = [np.column_stack([course.front_s, course.front_J])]
        _number(left, points, ("time_s", "energy_J"), front)
        _number(right, points, ("kbit", "collisions_all"))
    return figure


def shown(course: Course) -> list[NumberedRow]:
    """The rows that are drawn. Their numbers are their places in the table, from 1."""
    return [NumberedRow(number, row, _family(row)) for number, row in enumerate(course.standings, 1) if drawn(row)]


def write(courses: Sequence[Course], out: Path) -> dict[str, Path]:
    """Writes `out`/MISSION.png and .svg; the PNG of each mission that any row flew.

    Raises:
        OSError: it cannot be written.
    """
    return {
        course.name: plotstyle.save(draw(course), out, Path(course.name).stem)[0]
        for course in courses
        if any(map(drawn, course.standings))
    }


def drawn(row: Standing) -> bool:
    """Returns whether a row is in the pictures; not if all its UAVs were lost before they arrived."""
    return bool(row.cells) and (row.cells["arrived"].mean > 0.0 or not row.lost)


def _family(row: Standing) -> str:
    found = YOURS if row.yours else rows.family(row.name.partition("/")[0], row.controller)
    return found if found in LOOKS else OTHERS


def _time_energy(ax: Axes, course: Course, points: Sequence[NumberedRow]) -> None:
    if course.front_s:
        ax.plot(course.front_s, course.front_J, color=plotstyle.INK, linewidth=1.2)
        ax.fill_between(course.front_s, course.front_J, color=plotstyle.PALE, alpha=0.18, linewidth=0)
    for point in points:
        _point(ax, point, "time_s", "energy_J")
    ax.set_xscale("log")
    ax.set_yscale("log")
    means = np.array([_means(point.row, ("time_s", "energy_J")) for point in points])
    _frame(ax, means[:, 0].tolist(), means[:, 1].tolist())
    for axis in (ax.xaxis, ax.yaxis):
        low, high = axis.get_view_interval()
        leads = next((leads for leads in _LEADS if _written(leads, low, high) >= _LEAST_NUMBERS), _LEADS[-1])
        axis.set_minor_locator(LogLocator(subs=sorted({*range(2, 10), *leads[1:]}), numticks=_TICKS))
        axis.set_major_formatter(FuncFormatter(partial(_plain, leads)))
        axis.set_minor_formatter(FuncFormatter(partial(_plain, leads)))
    ax.tick_params(which="minor", labelsize=6.5)
    ax.set_xlabel("travel time T, duration if never arrived (s)")
    ax.set_ylabel("energy until arrival (J)")
    plotstyle.titled(ax, "a", f"time and energy{'; grey: infeasible' if course.front_s else ''}")


def _bits_collisions(ax: Axes, points: Sequence[NumberedRow]) -> None:
    for point in points:
        _point(ax, point, "kbit", "collisions_all")
    most_kbit, most_pairs = np.array([_means(point.row, ("kbit", "collisions_all")) for point in points]).max(axis=0)
    ax.set_xscale("symlog", linthresh=_LEAST_KBIT)
    ax.set_yscale("symlog", linthresh=_LEAST_PAIRS)
    ax.set_xlim(-0.15, max(10.0, most_kbit) * 4)
    ax.set_ylim(-0.06, max(1.0, most_pairs) * 2.5)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(partial(_plain, _LEADS[0])))
    ax.set_xlabel("sent until the last arrival (kbit)")
    ax.set_ylabel("collisions a flight (pairs)")
    plotstyle.titled(ax, "b", "bits and collisions: best is below left")


def _point(ax: Axes, point: NumberedRow, across: str, up: str) -> None:
    """Point and intervals of a row."""
    x, y = point.row.cells[across], point.row.cells[up]
    tone, marker, size = point.look
    edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.5}
    if not _arrives(point.row):
        edge = {"markeredgecolor": tone, "markeredgewidth": 1.0, "markerfacecolor": "white"}
    ax.errorbar(
        x.mean, y.mean, xerr=_bar(x), yerr=_bar(y), color=tone, marker=marker, markersize=size,
        elinewidth=0.8, zorder=5 if point.row.yours else 3, **edge,
    )  # fmt: skip


def _number(
    ax: Axes, points: Sequence[NumberedRow], keys: Keys, lines: Sequence[NDArray[np.float64]] = ()
) -> list[Block]:
    """Write the numbers of the rows, off their intervals and off `lines`."""
    numbered = [Numbered(point.number, *_means(point.row, keys), point.look.colour) for point in points]
    return labels.number(ax, numbered, [*lines, *(bar for point in points for bar in _bars(point.row, keys))])


def _legend(ax: Axes, points: Sequence[NumberedRow], has_front: bool) -> None:
    """The names of the numbers, by family, and what else the marks mean."""
    ax.set_axis_off()
    families = [family for family in LOOKS if any(point.family == family for point in points)]
    lines = len(points) + len(families) + 3
    step = min(_LINE_IN / _HEIGHT_IN, 1.0 / lines) / 0.92  # of the panel, which is lower than the figure
    size = min(_NAME_PT, _NAME_PT * step * _HEIGHT_IN * 0.92 / _LINE_IN + 0.5)
    ax.set(xlim=(0.0, _legend_in(points)), ylim=(0.0, 1.0))
    y = 1.0
    for family in families:
        tone, marker, mark = LOOKS[family]
        ax.plot(
            [0.06], [y], marker=marker, markersize=min(mark, 6.5), color=tone, markeredgecolor="white", clip_on=False
        )
        ax.text(0.18, y, family, color=tone, fontsize=size, fontweight="bold", va="center_baseline")
        for point in points:
            if point.family == family:
                y -= step
                ax.text(
                    0.34,
                    y,
                    str(point.number),
                    color=tone,
                    fontsize=size,
                    fontweight="bold",
                    ha="right",
                    va="center_baseline",
                )
                ax.text(0.40, y, point.row.name, fontsize=size, va="center_baseline")
        y -= 1.15 * step
    if not all(_arrives(point.row) for point in points):
        hollow: dict[str, Any] = {"marker": "o", "markersize": 4.5, "markerfacecolor": "white"}
        ax.plot([0.06], [y], color=plotstyle.INK, clip_on=False, **hollow)
        ax.text(0.18, y, "hollow: not all arrived", fontsize=size, va="center_baseline")
        y -= step
    if has_front:
        ax.plot([0.0, 0.12], [y, y], color=plotstyle.INK, linewidth=1.2, clip_on=False)
        ax.text(0.18, y, "least energy of one UAV", fontsize=size, va="center_baseline")


def _legend_in(points: Sequence[NumberedRow]) -> float:
    """Width of the legend, in."""
    return 0.45 + _LETTER_IN * max(20, *(len(point.row.name) for point in points))


def _arrives(row: Standing) -> bool:
    return row.cells["arrived"].mean >= COMPETES


def _bar(cell: BoardCell) -> NDArray[np.float64] | None:
    if cell.low is None or cell.high is None:
        return None
    return np.array([[cell.mean - max(cell.low, 0.0)], [cell.high - cell.mean]])


def _means(row: Standing, keys: Keys) -> tuple[float, float]:
    return row.cells[keys[0]].mean, row.cells[keys[1]].mean


def _bars(row: Standing, keys: Keys) -> Iterator[NDArray[np.float64]]:
    """Both intervals of a row, as lines in the plot's coordinates."""
    means = np.array(_means(row, keys))
    for axis, cell in enumerate(row.cells[key] for key in keys):
        if cell.low is not None and cell.high is not None:
            bar = np.stack([means, means])
            bar[:, axis] = max(cell.low, 0.0), cell.high
            yield bar


def _frame(ax: Axes, x: Sequence[float], y: Sequence[float]) -> None:
    """Limits that hold the points, with room for their numbers."""
    ax.set_xlim(min(x) / 1.35, max(x) * 1.5)
    ax.set_ylim(min(y) / 1.9, max(y) * 1.4)


def _written(leads: Sequence[float], low: float, high: float) -> int:
    """Number of labels with these leading digits on a logarithmic axis."""
    powers = range(math.floor(math.log10(low)), math.floor(math.log10(high)) + 1)
    return sum(low <= lead * 10.0**power <= high for lead in leads for power in powers)


def _plain(leads: Sequence[float], value: float, _: int | None = None) -> str:
    """Label of a number that is a leading digit times a power of ten; else empty."""
    if value == 0:
        return "0"
    lead = value / 10 ** math.floor(math.log10(abs(value)) + 1e-9)
    return f"{value:g}" if round(lead, 6) in leads else ""
