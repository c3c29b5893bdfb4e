"""Learning curves of a study: means over flights with a band of 95 %, over rounds, time, bits or airtime."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from meanflock.results import statistics
from meanflock.results.plots import plotstyle
from meanflock.results.plots.comparison import explained, lowest, panels, point_looks
from meanflock.results.plots.rounds import LABELS, label_axes, of_uavs, title
from meanflock.results.points import labels
from meanflock.results.rounds_table import MEAN, METRIC, OVER

Rounds = Sequence[Mapping[str, Any]]  # rows of rounds.parquet
_PANEL_IN = 1.45  # height
_BAND, _BANDS = 0.16, 0.5  # opacity of a band, and of all in a panel where they lie on one another, at most


def plot_learning(
    names: Sequence[str], points: Mapping[tuple[Any, ...], Sequence[Rounds]], over: str, columns: int = 2
) -> Figure | None:
    """A panel for each metric and diagnostic at the end of the rounds, a line for each point.

    A line has the rounds of which all flights of the point have the number, also void ones; a single round is a mark.
    Its place along the x axis is the mean of the flights. Numbers that stay the same are left out, if others change.
    The legend names the points that have a line. None if there is nothing to draw.

    Args:
        names: names of the varied values. points: the values of a point → the rounds of each of its flights.
        over: a key of OVER. columns: printed columns, and panels a row.
    """
    curves = {point: _columns(flights, OVER[over]) for point, flights in points.items()}
    found = dict.fromkeys(name for one in curves.values() for name in one if name.startswith((METRIC, MEAN)))
    shown = sorted(found, key=lambda name: name.startswith(MEAN))
    shown = [
        name
        for name in shown
        if any(np.nanmax(one[name]) > np.nanmin(one[name]) for one in curves.values() if name in one)
    ] or shown
    if not shown:
        return None
    named, looks = labels(names, points), point_looks(names, points)
    with plotstyle.style():
        figure, axes = panels([title(name) for name in shown], columns, _PANEL_IN, 0.85, "x")
        for name, ax in zip(shown, axes, strict=True):
            having = {point: one for point, one in curves.items() if name in one}
            for point, one in having.items():
                opacity = min(_BAND, 1.0 - (1.0 - _BANDS) ** (1.0 / len(having)))
                _curve(ax, looks[point], one[OVER[over]].mean(axis=0), one[name], opacity)
            label_axes(ax, name, over)
        for ax in lowest(axes):
            ax.set_xlabel(LABELS[over])
        drawn = {named[point]: looks[point] for point, one in curves.items() if not one.keys().isdisjoint(shown)}
        has_points = any(len(one[OVER[over]][0]) == 1 for one in curves.values() if one)
        plotstyle.legend(figure, list(drawn), markers=has_points, looks=drawn)
        before = f"{of_uavs(shown)}\n".lstrip()
        explained(figure, [len(flights) for flights in points.values()], before)
    return figure


def _columns(flights: Sequence[Rounds], along: str) -> dict[str, NDArray[np.float64]]:
    """Columns (flights, rounds) of the rounds that all flights have, NaN where unknown; without those of no line."""
    ended = [{row["round"]: row for row in rounds} for rounds in flights]
    common = sorted(set.intersection(*map(set, ended)))
    if not common:
        return {}
    names = [
        along,
        *dict.fromkeys(
            name for one in ended for row in one.values() for name in row if name.startswith((METRIC, MEAN))
        ),
    ]
    rows = {name: [[one[number].get(name) for number in common] for one in ended] for name in names}
    arrays = {name: np.array(values, dtype=np.float64) for name, values in rows.items()}
    return {name: array for name, array in arrays.items() if not np.isnan(array).any(axis=0).all()}


def _curve(
    ax: Any, seen: plotstyle.MethodLook, x: NDArray[np.float64], values: NDArray[np.float64], opacity: float
) -> None:
    known = ~np.isnan(values).any(axis=0)
    x, estimates = x[known], [statistics.mean(column) for column in values.T[known]]
    if len(x) == 1:
        plotstyle.dots(ax, seen, x, estimates)
        return
    y, low, high = (np.array([getattr(each, end) for each in estimates]) for end in ("value", "low", "high"))
    if np.isfinite([low, high]).any():
        ax.fill_between(x, low, high, where=np.isfinite(low), color=seen.colour, alpha=opacity, linewidth=0)
    ax.plot(x, y, color=seen.colour, linestyle=seen.dash, linewidth=seen.width)
