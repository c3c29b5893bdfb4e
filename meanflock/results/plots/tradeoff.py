"""The Pareto front of two measures: a point with both intervals for each configuration."""

import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator

from meanflock.results.plots import plotstyle
from meanflock.results.plots.comparison import explained
from meanflock.results.statistics import Estimate

_HEIGHT_IN = 2.8  # with one line of the legend
FRONT, UNDECIDED, DOMINATED = "front", "undecided", "dominated"
_MEANINGS = {FRONT: "filled: on the front", UNDECIDED: "hollow: undecided", DOMINATED: "pale: dominated"}
_PALE = 0.35  # opacity
_MOST_NAMES = 12  # of more points those that are dominated have no name
_ROOM = 0.65  # share of the width and height of the figure that a label may take


class TradeoffPoint(NamedTuple):
    """A configuration: its label and look, its means, and `front`, `dominated` or `undecided`."""

    label: str
    look: plotstyle.MethodLook
    x: Estimate
    y: Estimate
    place: str


def plot_tradeoff(
    points: Sequence[TradeoffPoint], x: str, y: str, columns: int = 1, unknown: Sequence[str] = ()
) -> Figure:
    """Means and 95 % intervals: filled on the front, hollow where undecided, pale where dominated.

    The legend names all points, or of more than 12 those that are not dominated.

    x, y: labels of the axes. unknown: labels of configurations of which a mean is unknown, for the caption.
    """
    ink = plotstyle.MethodLook(plotstyle.INK, "o", plotstyle.SOLID)
    ordered = sorted(points, key=lambda point: [*_MEANINGS].index(point.place))
    named = [point for point in ordered if len(points) <= _MOST_NAMES or point.place != DOMINATED]
    marks = [(point.look, point.place, point.label) for point in named]
    marks += [(ink, place, _MEANINGS[place]) for place in dict.fromkeys(point.place for point in ordered)]
    handles = [plotstyle.mark(look, label, linestyle="", **_shade(look, place)) for look, place, label in marks]
    with plotstyle.style():
        figure = plotstyle.figure(plotstyle.WIDTHS_IN[columns], _HEIGHT_IN)
        ax = figure.subplots()
        for point in points:
            _draw(ax, point)
        for label, set_label, room_in in (
            (x, ax.set_xlabel, plotstyle.WIDTHS_IN[columns]),
            (y, ax.set_ylabel, _HEIGHT_IN),
        ):
            set_label(plotstyle.tex(textwrap.fill(label, int(_ROOM * room_in * plotstyle.LETTERS_IN))))
        ax.xaxis.set_major_locator(MaxNLocator(4 * columns))
        for axis, label in ((ax.xaxis, x), (ax.yaxis, y)):
            if "(bits)" in label:
                axis.set_major_formatter(EngFormatter())
        plotstyle.place_legend(figure, handles)
        before = f"not drawn, because a number is unknown: {', '.join(unknown)}\n" if unknown else ""
        explained(figure, [point.x.n for point in points], before)
    return figure


def _shade(seen: plotstyle.MethodLook, place: str) -> dict[str, Any]:
    """How a mark shows the place of its point."""
    face = "white" if place == UNDECIDED else seen.colour
    return {"markerfacecolor": face, "alpha": _PALE if place == DOMINATED else 1.0}


def _draw(ax: Axes, point: TradeoffPoint) -> None:
    bars = [
        np.array([[each.value - each.low], [each.high - each.value]]) if each.bounded else None
        for each in (point.x, point.y)
    ]
    ax.errorbar(
        point.x.value, point.y.value, xerr=bars[0], yerr=bars[1], color=point.look.colour, marker=point.look.marker,
        markersize=5.0, elinewidth=0.8, capsize=1.5, zorder=2 if point.place == DOMINATED else 3,
        **_shade(point.look, point.place),
    )  # fmt: skip
