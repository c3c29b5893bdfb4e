"""The Pareto front of two measures: a point with both intervals for each configuration."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, MaxNLocator

from meanflock.results.plots import plotstyle
from meanflock.results.plots.comparison import explained
from meanflock.results.statistics import Estimate

_HEIGHT_IN = 2.8  # with one line of the legend
FRONT, UNDECIDED, DOMINATED = "front", "undecided", "dominated"


class TradeoffPoint(NamedTuple):
    """A configuration: its label, its means, and `front`, `dominated` or `undecided`."""

    label: str
    x: Estimate
    y: Estimate
    place: str


def plot_tradeoff(points: Sequence[TradeoffPoint], x: str, y: str, columns: int = 1) -> Figure:
    """Means and 95 % intervals: filled on the front, hollow where undecided, grey where dominated.

    x, y: labels of the axes.
    """
    competing = sorted((point for point in points if point.place != DOMINATED), key=lambda point: point.place != FRONT)
    looks = plotstyle.looks(point.label for point in competing)
    grey = plotstyle.MethodLook(plotstyle.PALE, ".", (0, ()))
    handles = [_mark(looks[point.label], point.place, point.label) for point in competing]
    ink = plotstyle.MethodLook(plotstyle.INK, "o", (0, ()))
    for place, look, meaning in (
        (FRONT, ink, "filled: on the front"),
        (UNDECIDED, ink, "hollow: undecided"),
        (DOMINATED, grey, "grey: dominated"),
    ):
        if any(point.place == place for point in points):
            handles.append(_mark(look, place, meaning))
    with plotstyle.style():
        figure = plotstyle.figure(plotstyle.WIDTHS_IN[columns], _HEIGHT_IN)
        ax = figure.subplots()
        for point in points:
            _draw(ax, point, looks.get(point.label, grey))
        ax.set_xlabel(plotstyle.tex(x))
        ax.set_ylabel(plotstyle.tex(y))
        ax.xaxis.set_major_locator(MaxNLocator(4 * columns))
        for axis, label in ((ax.xaxis, x), (ax.yaxis, y)):
            if "(bits)" in label:
                axis.set_major_formatter(EngFormatter())
        plotstyle.place_legend(figure, handles)
        explained(figure, [point.x.n for point in points])
    return figure


def _mark(seen: plotstyle.MethodLook, place: str, label: str) -> Line2D:
    """A mark as the points of that place have it, for the legend."""
    face = "white" if place == UNDECIDED else seen.colour
    return plotstyle.mark(seen, label, linestyle="", markerfacecolor=face)


def _draw(ax: Axes, point: TradeoffPoint, seen: plotstyle.MethodLook) -> None:
    bars = [
        np.array([[each.value - each.low], [each.high - each.value]]) if each.bounded else None
        for each in (point.x, point.y)
    ]
    ax.errorbar(
        point.x.value, point.y.value, xerr=bars[0], yerr=bars[1], color=seen.colour, marker=seen.marker, markersize=5.0,
        markerfacecolor="white" if point.place == UNDECIDED else seen.colour, elinewidth=0.8, capsize=1.5,
        zorder=2 if point.place == DOMINATED else 3,
    )  # fmt: skip
