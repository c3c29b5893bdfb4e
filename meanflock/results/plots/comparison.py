"""Plots of many flights: methods side by side, and a parameter swept."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from meanflock.results import statistics
from meanflock.results.plots import plotstyle
from meanflock.results.quantities import COMPARED, FIELDS, number, with_unit

Floats = NDArray[np.float64]
Summaries = Sequence[Mapping[str, Any]]  # of runs that differ in their seed
Points = Mapping[tuple[Any, ...], Summaries]

_METHOD = "method"
_PLUGINS = (_METHOD, "training.learner")
FLIGHTS_BELOW = 0.32  # of the distance of two rows
_APART = 0.012  # points of one number, as a share of the axis; so their intervals do not cover each other
_TICKS_APART = 0.12  # numbers nearer to each other, as a share of the axis, have no ticks of their own
_APART_WITHIN = 0.4, 0.1  # the same of one category: of all points and of two neighbours, at most


def panels(
    titles: Sequence[str], columns: int, row_in: float, more_in: float, share: str = ""
) -> tuple[Figure, list[Axes]]:
    """A figure of a printed width with so many panels a row, which share an axis; rows are so high, and all so much
    more.
    """
    across = min(columns, len(titles))
    rows = -(-len(titles) // across)
    figure = plotstyle.figure(plotstyle.WIDTHS_IN[columns], rows * row_in + more_in)
    axes = list(figure.subplots(rows, across, squeeze=False, sharex=share == "x", sharey=share == "y").ravel())
    for place, (title, ax) in enumerate(zip(titles, axes, strict=False)):
        plotstyle.titled(ax, plotstyle.letter(place), title)
    for ax in axes[len(titles) :]:
        ax.set_visible(False)
    return figure, axes


def plot_compare(runs: Mapping[str, Summaries], columns: int = 2) -> Figure:
    """A panel a metric, a method a row: the mean with its 95 % interval over seeds, and below it a pale dot a run.

    runs: by method the summaries of its runs. columns: printed columns, and panels a row.
    """
    methods, looks = list(runs), plotstyle.looks(runs)
    with plotstyle.style():
        figure, axes = panels(_titles(COMPARED), columns, 0.75 + 0.22 * len(methods), 0.3, "y")
        for key, ax in zip(COMPARED, axes, strict=False):
            for place, method in enumerate(methods):
                values = np.array([number(summary, key) for summary in runs[method]])
                _row(ax, place, values, looks[method])
            ax.set_ylim(len(methods) - 0.4, -0.5)
            ax.set_yticks(range(len(methods)), methods)
            ax.grid(visible=False, axis="y")
            ax.set_xlabel(plotstyle.axis(key))
            ax.xaxis.set_major_locator(MaxNLocator(6, integer=key in ("arrived", "collisions")))
            if key.startswith("payload_bits"):
                plotstyle.bit_axis(ax.xaxis)
            if key == "arrived":
                most = max(number(summary, "uavs") for summaries in runs.values() for summary in summaries)
                ax.set_xlim(0.0, most)
            _never_negative(ax.xaxis)
        explained(figure, [len(summaries) for summaries in runs.values()], "pale: single flights; ")
    return figure


def _titles(metrics: Sequence[str]) -> list[str]:
    return [FIELDS[metric].remarked for metric in metrics]


def _never_negative(axis: Axis) -> None:
    """Begins an axis just before 0 where it would begin farther below: no metric here is negative."""
    low, high = axis.get_view_interval()
    if low <= 0.0:
        high = max(high, 1.0) if axis.get_data_interval()[1] <= 0.0 else high
        limit = axis.axes.set_xlim if isinstance(axis, XAxis) else axis.axes.set_ylim
        limit(-0.03 * high, 1.03 * high)


def _row(ax: Axes, place: int, values: Floats, look: plotstyle.MethodLook) -> None:
    """A method's mean and its interval, and its flights below them, where neither covers them."""
    estimate = statistics.mean(values)
    pale: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3, "markeredgewidth": 0.0, "alpha": 0.45}
    ax.plot(values, np.full(len(values), place + FLIGHTS_BELOW), color=look.colour, **pale)
    if estimate.bounded:
        ax.plot([max(estimate.low, 0.0), estimate.high], [place, place], color=look.colour, linewidth=2.0)
    mean: dict[str, Any] = {"marker": look.marker, "markersize": 6, "markeredgecolor": "white"}
    ax.plot([estimate.value], [place], color=look.colour, **mean)


def explained(figure: Figure, flights: Sequence[int], before: str = "") -> None:
    """Explain points and bars, below all panels."""
    least, most = min(flights), max(flights)
    several = f"mean and 95 % interval over {least if least == most else f'{least} to {most}'} flights"
    caption = before + (several if most > 1 else "one flight each: no interval")
    figure.supxlabel(caption, fontsize=7, color=plotstyle.INK)


def labels(names: Sequence[str], points: Iterable[tuple[Any, ...]]) -> dict[tuple[Any, ...], str]:
    """The label of each point: its values of the names that vary, or of all if none does.

    Methods and learners come first, without a name. Keys are without their table if that is enough to tell them apart.
    """
    points = dict.fromkeys(points)
    places = sorted(range(len(names)), key=lambda place: names[place] not in _PLUGINS)
    varying = [place for place in places if len({point[place] for point in points}) > 1] or places
    ends = [name.rpartition(".")[2] for name in names]
    shown = [end if ends.count(end) == 1 else name for end, name in zip(ends, names, strict=True)]
    return {
        point: ", ".join(
            str(point[place]) if names[place] in _PLUGINS else f"{shown[place]}={point[place]}" for place in varying
        )
        for point in points
    }


class _Line(NamedTuple):
    """Points of a study that differ in the first swept key only. name: the values of the other keys."""

    name: str
    points: dict[Any, tuple[Any, ...]]  # by the value of that key


def _lines(names: Sequence[str], points: Iterable[tuple[Any, ...]]) -> tuple[str, list[_Line]]:
    """The first swept key, and the lines of a study along it."""
    key = next((name for name in names if name != _METHOD), _METHOD)
    along = list(names).index(key)
    found: dict[tuple[Any, ...], dict[Any, tuple[Any, ...]]] = {}
    for point in points:
        found.setdefault((*point[:along], *point[along + 1 :]), {})[point[along]] = point
    named = labels([name for name in names if name != key], found)
    return key, [_Line(named[line], at) for line, at in found.items()]


def point_looks(names: Sequence[str], points: Iterable[tuple[Any, ...]]) -> dict[tuple[Any, ...], plotstyle.MethodLook]:
    """The look of each point, in every figure of a study that draws points.

    A point has the colour of its line in the sweep; marker and dash tell its values of the swept key. Points of a
    single line, and methods side by side, have a colour each.
    """
    points = list(dict.fromkeys(points))
    _, lines = _lines(names, points)
    if len(lines) == 1 or len(lines) == len(points):
        named = labels(names, points)
        looks = plotstyle.looks(named.values())
        return {point: looks[named[point]] for point in points}
    looks = plotstyle.looks(line.name for line in lines)
    values = list(dict.fromkeys(value for line in lines for value in line.points))
    return {
        point: plotstyle.variant(looks[line.name], values.index(value))
        for line in lines
        for value, point in line.points.items()
    }


def plot_points(names: Sequence[str], points: Points, columns: int = 2) -> Figure:
    """A study: methods side by side, or a sweep.

    Args:
        names: names of the varied values, without units. points: the values of a point → the summaries of its flights.
        columns: printed columns, and panels a row.
    """
    if tuple(names) == (_METHOD,):
        return plot_compare({method: summaries for (method,), summaries in points.items()}, columns)
    return plot_sweep(names, points, columns)


def plot_sweep(names: Sequence[str], points: Points, columns: int = 2) -> Figure:
    """A panel a metric along the first swept key: mean over seeds with 95 % interval, in the look of each method and
    combination of the other keys.

    Numbers are joined by lines. Values that are not all numbers are put side by side, without lines. Arguments as for
    `plot_points`.
    """
    key, lines = _lines(names, points)
    values = list(dict.fromkeys(point[list(names).index(key)] for point in points))
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    places = np.array(values if numeric else range(len(values)), dtype=np.float64)
    looks = plotstyle.looks(line.name for line in lines)
    most, least = _APART_WITHIN
    apart = _APART * np.ptp(places) if numeric else min(least, most / len(lines))
    with plotstyle.style():
        figure, axes = panels(_titles(COMPARED[:4]), columns, 1.75, 0.65, "x")
        for metric, ax in zip(COMPARED[:4], axes, strict=True):
            for place, line in enumerate(lines):
                offset = apart * (place - (len(lines) - 1) / 2)
                flown = [points[line.points[value]] if value in line.points else () for value in values]
                estimates = [statistics.mean([number(each, metric) for each in summaries]) for summaries in flown]
                plotstyle.dots(ax, looks[line.name], places + offset, estimates, joined=numeric)
            _never_negative(ax.yaxis)
            ax.set_ylabel(plotstyle.axis(metric))
            if metric.startswith("payload_bits"):
                plotstyle.bit_axis(ax.yaxis)
            if not numeric or np.diff(np.sort(places)).min(initial=np.inf) >= _TICKS_APART * np.ptp(places):
                ax.set_xticks(places, [str(value) for value in values])
            if not numeric:
                ax.set_xlim(-0.5, len(values) - 0.5)
                ax.grid(visible=False, axis="x")
        for ax in axes[-columns:]:
            ax.set_xlabel(with_unit(key))
        joined = {"linestyle": "-" if numeric else ""}
        plotstyle.place_legend(figure, [plotstyle.mark(look, name, **joined) for name, look in looks.items()])
        explained(figure, [len(summaries) for summaries in points.values()])
    return figure
