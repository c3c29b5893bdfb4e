"""The Pareto front of two measures: a point with both intervals for each configuration."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, MaxNLocator

from meanflock.results.plots import plotstyle
from meanflock.results.statistics import Estimate

_HEIGHT_IN = 2.6
_LINE_IN = 0.17  # height of a line of the legend
FRONT, DOMINATED = "front", "dominated"


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
    competing = [point for point in points if point.place != DOMINATED]
    looks = plotstyle.looks(point.label for point in competing)
    grey = plotstyle.MethodLook(plotstyle.PALE, ".", (0, ()))
    extra = [Line2D([], [], color=plotstyle.PALE, marker=".", linestyle="", label=DOMINATED)]
    extra = extra if len(competing) < len(points) else []
    hollow = Line2D([], [], color=plotstyle.INK, marker="o", linestyle="", markerfacecolor="white", label="undecided")
    extra += [hollow] if any(point.place != FRONT for point in competing) else []
    with plotstyle.style():
        height = _HEIGHT_IN + _LINE_IN * (len(competing) + len(extra)) / columns
        figure = plotstyle.figure(plotstyle.WIDTHS_IN[columns], height)
        ax = figure.subplots()
        for point in points:
            _draw(ax, point, looks.get(point.label, grey))
        ax.set_xlabel(plotstyle.tex(x))
        ax.set_ylabel(plotstyle.tex(y))
        ax.xaxis.set_major_locator(MaxNLocator(4 * columns))
        for axis, label in ((ax.xaxis, x), (ax.yaxis, y)):
            if "(bits)" in label:
                axis.set_major_formatter(EngFormatter())
        plotstyle.legend(figure, [point.label for point in competing], markers=True, extra=extra, looks=looks)
        counts = [point.x.n for point in points]
        figure.supxlabel(f"means and 95 % intervals over {min(counts)} flights", fontsize=7, color=plotstyle.INK)
    return figure


def _draw(ax: Axes, point: TradeoffPoint, seen: plotstyle.MethodLook) -> None:
    bars = [
        np.array([[each.value - each.low], [each.high - each.value]]) if each.bounded else None
        for each in (point.x, point.y)
    ]
    ax.errorbar(
        point.x.value, point.y.value, xerr=bars[0], yerr=bars[1], color=seen.colour, marker=seen.marker, markersize=5.0,
        markerfacecolor=seen.colour if point.place == FRONT else "white", elinewidth=0.8, capsize=1.5,
        zorder=2 if point.place == DOMINATED else 3,
    )  # fmt: skip
