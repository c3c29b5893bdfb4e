"""The pictures of a mission: time and energy with the front, and bits and collisions; a row a point."""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator
from numpy.typing import NDArray

from meanflock.groundstation.plots import plotstyle
from meanflock.studies.leaderboard.board import Cell, Course, Standing
from meanflock.studies.leaderboard.labels import Named, label
from meanflock.studies.leaderboard.marks import COMPETES

YOURS = "#CC2222"
_ORDINARY = 4.5  # size of a marker
_YOURS = 11.0
_LEADS = (
    (1, 2, 3, 5),
    (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9),
)  # leading digits of the numbers at an axis; the shortest list that suffices is used
_LEAST_NUMBERS = 2  # least numbers at an axis
_TICKS = 100  # of an axis, at the most
_LEAST_KBIT, _LEAST_PAIRS = 1.0, 0.1  # below, the axes are linear, so that nothing has a place


def draw(course: Course) -> Figure:
    """Both plots of a mission, side by side."""
    rows = [row for row in course.standings if drawn(row)]
    with plotstyle.style():
        figure = plotstyle.figure(plotstyle.PAGE_IN * 1.25, 5.2)
        left, right = figure.subplots(1, 2)
        _time_energy(left, course, rows)
        _bits_collisions(right, rows)
        figure.draw_without_rendering()
        front = [np.column_stack([course.front_s, course.front_J])]
        for ax, keys, lines in ((left, ("time_s", "energy_J"), front), (right, ("kbit", "collisions_all"), [])):
            named = [Named(row.name, *_means(row, keys), _tone(row), row.yours) for row in rows]
            label(ax, named, [*lines, *(bar for row in rows for bar in _bars(row, keys))])
    return figure


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


def _time_energy(ax: Axes, course: Course, rows: Sequence[Standing]) -> None:
    if course.front_s:
        ax.plot(
            course.front_s, course.front_J, color=plotstyle.INK, linewidth=1.2, label="least energy of one UAV alone"
        )
        ax.fill_between(course.front_s, course.front_J, color=plotstyle.PALE, alpha=0.18, linewidth=0)
    for row in rows:
        _point(ax, row, "time_s", "energy_J")
    if not all(map(_arrives, rows)):
        hollow: dict[str, Any] = {"linestyle": "", "marker": "o", "markerfacecolor": "white", "color": plotstyle.INK}
        ax.plot([], [], **hollow, label="hollow: not everybody arrived")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper right", fontsize=7)
    ax.set_xscale("log")
    ax.set_yscale("log")
    _frame(ax, [row.cells["time_s"].mean for row in rows], [row.cells["energy_J"].mean for row in rows])
    for axis in (ax.xaxis, ax.yaxis):
        low, high = axis.get_view_interval()
        leads = next((leads for leads in _LEADS if _written(leads, low, high) >= _LEAST_NUMBERS), _LEADS[-1])
        axis.set_minor_locator(LogLocator(subs=sorted({*range(2, 10), *leads[1:]}), numticks=_TICKS))
        axis.set_major_formatter(FuncFormatter(partial(_plain, leads)))
        axis.set_minor_formatter(FuncFormatter(partial(_plain, leads)))
    ax.tick_params(which="minor", labelsize=6.5)
    ax.set_xlabel("travel time T (s)")
    ax.set_ylabel("energy until arrival (J)")
    plotstyle.titled(ax, "a", "time and energy; grey: infeasible energy")


def _bits_collisions(ax: Axes, rows: Sequence[Standing]) -> None:
    for row in rows:
        _point(ax, row, "kbit", "collisions_all")
    ax.set_xscale("symlog", linthresh=_LEAST_KBIT)
    ax.set_yscale("symlog", linthresh=_LEAST_PAIRS)
    ax.set_xlim(-0.15, max(10.0, *(row.cells["kbit"].mean for row in rows)) * 4)
    ax.set_ylim(-0.06, max(1.0, *(row.cells["collisions_all"].mean for row in rows)) * 2.5)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(partial(_plain, _LEADS[0])))
    ax.set_xlabel("sent until the last arrival (kbit)")
    ax.set_ylabel("collisions a flight (pairs, arrived UAVs too)")
    plotstyle.titled(ax, "b", "bits and collisions: best is below and left")


def _point(ax: Axes, row: Standing, across: str, up: str) -> None:
    """Point and intervals of a row."""
    x, y = row.cells[across], row.cells[up]
    tone, size = _tone(row), _YOURS if row.yours else _ORDINARY
    marker = "*" if row.yours else plotstyle.look(row.name).marker
    edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.5}
    if not _arrives(row):
        edge = {"markeredgecolor": tone, "markeredgewidth": 1.0, "markerfacecolor": "white"}
    ax.errorbar(
        x.mean, y.mean, xerr=_bar(x), yerr=_bar(y), color=tone, marker=marker, markersize=size,
        elinewidth=0.9, zorder=5 if row.yours else 3, **edge,
    )  # fmt: skip


def _arrives(row: Standing) -> bool:
    return row.cells["arrived"].mean >= COMPETES


def _bar(cell: Cell) -> NDArray[np.float64] | None:
    if cell.low is None or cell.high is None:
        return None
    return np.array([[cell.mean - max(cell.low, 0.0)], [cell.high - cell.mean]])


def _tone(row: Standing) -> str:
    return YOURS if row.yours else plotstyle.colour(row.name)


def _means(row: Standing, keys: tuple[str, str]) -> tuple[float, float]:
    return row.cells[keys[0]].mean, row.cells[keys[1]].mean


def _bars(row: Standing, keys: tuple[str, str]) -> Iterator[NDArray[np.float64]]:
    """Both intervals of a row, as lines in the plot's coordinates."""
    means = np.array(_means(row, keys))
    for axis, cell in enumerate(row.cells[key] for key in keys):
        if cell.low is not None and cell.high is not None:
            bar = np.stack([means, means])
            bar[:, axis] = max(cell.low, 0.0), cell.high
            yield bar


def _frame(ax: Axes, x: Sequence[float], y: Sequence[float]) -> None:
    """Limits that hold the points, with room for their names."""
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
