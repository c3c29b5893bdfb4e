"""Plots of many flights: methods side by side, and a parameter swept."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure
from matplotlib.markers import CARETDOWN, CARETLEFT, CARETRIGHT, CARETUP
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from meanflock.results import statistics
from meanflock.results.plots import plotstyle
from meanflock.results.points import METHOD, labels, telling
from meanflock.results.quantities import COMPARED, FIELDS, number, with_unit
from meanflock.results.statistics import Estimate

Floats = NDArray[np.float64]
Summaries = Sequence[Mapping[str, Any]]  # of runs that differ in their seed
Points = Mapping[tuple[Any, ...], Summaries]

_PAGE_IN = 9.0  # height of the text of a printed page
FLIGHTS_BELOW = 0.32  # of the distance of two rows
_APART = 0.012  # points of one number, as a share of the axis; so their intervals do not cover each other
_TICKS_APART = 0.12  # numbers nearer to each other, as a share of the axis, have no ticks of their own
_APART_WITHIN = 0.4, 0.1  # the same of one category: of all points and of two neighbours, at most


def panels(
    titles: Sequence[str],
    columns: int,
    row_in: float,
    more_in: float,
    share: str,
    least_in: float | None = None,
    left_in: float = 0.0,
    most_rows: int = 4,
) -> tuple[Figure, list[Axes]]:
    """A figure of a printed width with a panel for each title, in as many columns as are printed.

    Args:
        row_in: height of a row. more_in: further height. share: the axis that all panels share. Numbers of a shared x
            axis are below the lowest panels.
        least_in: height of a row where the figure would be longer than a page otherwise; None: `row_in`.
        left_in: width of what stands left of all panels.
        most_rows: of panels; more have a column more.
    """
    across = min(columns + (len(titles) > most_rows * columns), len(titles))
    rows = -(-len(titles) // across)
    if least_in is not None:
        row_in = max(least_in, min(row_in, (_PAGE_IN - more_in) / rows))
    figure = plotstyle.figure(plotstyle.WIDTHS_IN[columns], rows * row_in + more_in)
    axes = list(figure.subplots(rows, across, squeeze=False, sharex=share == "x", sharey=share == "y").ravel())
    for place, (title, ax) in enumerate(zip(titles, axes, strict=False)):
        plotstyle.titled(ax, plotstyle.letter(place), title, left_in)
    for ax in axes[len(titles) :]:
        ax.remove()
    axes = axes[: len(titles)]
    for ax in lowest(axes):
        ax.xaxis.set_tick_params(labelbottom=True)
    return figure, axes


def lowest(axes: Sequence[Axes]) -> Sequence[Axes]:
    """The lowest panel of each column."""
    place = axes[0].get_subplotspec()
    assert place is not None
    return axes[-place.get_gridspec().ncols :]


def plot_compare(runs: Mapping[str, Summaries], columns: int = 2) -> Figure:
    """A panel a metric, a method a row: the mean with its 95 % interval over seeds, and below it a pale dot a run.

    runs: by method the summaries of its runs. columns: printed columns.
    """
    methods, looks, has_arrows = list(runs), plotstyle.looks(runs), False
    with plotstyle.style():
        row_in, least_in = (0.75 + each_in * len(methods) for each_in in (0.22, 0.13))
        left_in = max(map(len, methods)) / plotstyle.LETTERS_IN
        figure, axes = panels(_titles(COMPARED), columns, row_in, 0.3, "y", least_in, left_in)
        ticks = 6 if columns > 1 else 3
        for key, ax in zip(COMPARED, axes, strict=True):
            estimates = [
                _row(ax, place, np.array([number(summary, key) for summary in runs[method]]), looks[method])
                for place, method in enumerate(methods)
            ]
            ax.set_ylim(len(methods) - 0.4, -0.5)
            ax.set_yticks(range(len(methods)), methods)
            ax.grid(visible=False, axis="y")
            ax.set_xlabel(plotstyle.axis(key))
            _scale(ax.xaxis, key, runs.values(), ticks)
            for place, (method, estimate) in enumerate(zip(methods, estimates, strict=True)):
                has_arrows |= _arrows(ax.xaxis, [place], [estimate], looks[method].colour)
        flights = [len(summaries) for summaries in runs.values()]
        explained(figure, flights, "pale: single flights; ", has_arrows)
    return figure


def _titles(metrics: Sequence[str]) -> list[str]:
    return [FIELDS[metric].remarked for metric in metrics]


def _scale(axis: Axis, metric: str, flown: Iterable[Summaries], ticks: int) -> None:
    """Sets ticks and limits of a metric: counts are whole, arrivals end at the number of UAVs. An axis begins just
    before 0 where it would begin farther below: no metric here is negative."""
    axis.set_major_locator(MaxNLocator(ticks, integer=metric in ("arrived", "collisions")))
    if metric.startswith("payload_bits"):
        plotstyle.bit_axis(axis)
    limit = axis.axes.set_xlim if isinstance(axis, XAxis) else axis.axes.set_ylim
    if metric == "arrived":
        limit(0.0, max(number(summary, "uavs") for summaries in flown for summary in summaries))
    low, high = axis.get_view_interval()
    if low <= 0.0:
        high = max(high, 1.0) if axis.get_data_interval()[1] <= 0.0 else high
        limit(-0.03 * high, 1.03 * high)


def _arrows(axis: Axis, at: Sequence[float], estimates: Sequence[Estimate], colour: str) -> bool:
    """Draws an arrow at the end of an axis where an interval goes on beyond it. Returns whether any does.

    at: places of the intervals across the axis.
    """
    low, high = axis.get_view_interval()
    is_along_x = isinstance(axis, XAxis)
    before, after = (CARETLEFT, CARETRIGHT) if is_along_x else (CARETDOWN, CARETUP)
    ends = [
        (place, end, marker)
        for place, one in zip(at, estimates, strict=True)
        for end, marker, beyond in ((low, before, one.low < low), (high, after, one.high > high))
        if one.bounded and beyond
    ]
    for place, end, marker in ends:
        where = (end, place) if is_along_x else (place, end)
        axis.axes.plot(*where, marker=marker, markersize=4.0, color=colour, linestyle="", clip_on=False)
    return bool(ends)


def _row(ax: Axes, place: int, values: Floats, look: plotstyle.MethodLook) -> Estimate:
    """A method's mean and its interval, which it returns, and its flights below them, where neither covers them."""
    estimate = statistics.mean(values)
    pale: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3, "markeredgewidth": 0.0, "alpha": 0.45}
    ax.plot(values, np.full(len(values), place + FLIGHTS_BELOW), color=look.colour, **pale)
    if estimate.bounded:
        ax.plot([estimate.low, estimate.high], [place, place], color=look.colour, linewidth=2.0)
    mean: dict[str, Any] = {"marker": look.marker, "markersize": 6, "markeredgecolor": "white"}
    ax.plot([estimate.value], [place], color=look.colour, **mean)
    return estimate


def explained(figure: Figure, flights: Sequence[int], before: str = "", has_arrows: bool = False) -> None:
    """Explain points, bars and arrows, below all panels."""
    least, most = min(flights), max(flights)
    several = f"mean and 95 % interval over {least if least == most else f'{least} to {most}'} flights"
    caption = before + (several if most > 1 else "one flight each: no interval")
    caption += "; arrow: the interval goes on beyond the axis" if has_arrows else ""
    plotstyle.captioned(figure, caption)


class _Line(NamedTuple):
    """Points of a study that differ in the first swept key only. name: the values of the other keys."""

    name: str
    points: dict[Any, tuple[Any, ...]]  # by the value of that key


def _lines(names: Sequence[str], points: Iterable[tuple[Any, ...]]) -> tuple[str, list[_Line]]:
    """The first swept key, and the lines of a study along it."""
    points = list(dict.fromkeys(points))
    places = telling(names, points)
    along = next((place for place in places if names[place] != METHOD), places[0])
    others = [place for place in places if place != along]
    found: dict[tuple[Any, ...], dict[Any, tuple[Any, ...]]] = {}
    for point in points:
        found.setdefault(tuple(point[place] for place in others), {})[point[along]] = point
    named = labels([names[place] for place in others], found)
    return names[along], [_Line(named[line], at) for line, at in found.items()]


def point_looks(names: Sequence[str], points: Iterable[tuple[Any, ...]]) -> dict[tuple[Any, ...], plotstyle.MethodLook]:
    """The look of each point, in every figure of a study that draws points.

    A point has the colour of its line in the sweep; marker and dash tell its values of the swept key. Points of a
    single line, methods side by side, and points of more lines than colours or more values than dashes have looks of
    their own.
    """
    points = list(dict.fromkeys(points))
    _, lines = _lines(names, points)
    values = list(dict.fromkeys(value for line in lines for value in line.points))
    if len(lines) == 1 or len(lines) > len(plotstyle.COLOURS) or len(values) > len(plotstyle.DASHES):
        named = labels(names, points)
        own = plotstyle.looks(named.values())
        return {point: own[named[point]] for point in points}
    looks = plotstyle.looks(line.name for line in lines)
    return {
        point: plotstyle.variant(looks[line.name], values.index(value))
        for line in lines
        for value, point in line.points.items()
    }


def plot_points(names: Sequence[str], points: Points, columns: int = 2) -> Figure:
    """A study: methods side by side, or a sweep.

    Args:
        names: names of the varied values, without units. points: the values of a point → the summaries of its flights.
        columns: printed columns.
    """
    if [names[place] for place in telling(names, points)] == [METHOD]:
        of_method = names.index(METHOD)
        return plot_compare({point[of_method]: summaries for point, summaries in points.items()}, columns)
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
    has_arrows = False
    apart = _APART * np.ptp(places) if numeric else min(least, most / len(lines))
    with plotstyle.style():
        figure, axes = panels(_titles(COMPARED), columns, 1.75, 0.65, "x", 1.1, most_rows=len(COMPARED))
        for metric, ax in zip(COMPARED, axes, strict=True):
            drawn = []
            for place, line in enumerate(lines):
                at = places + apart * (place - (len(lines) - 1) / 2)
                flown = [points[line.points[value]] if value in line.points else () for value in values]
                estimates = [statistics.mean([number(each, metric) for each in summaries]) for summaries in flown]
                plotstyle.dots(ax, looks[line.name], at, estimates, joined=numeric)
                drawn.append((list(at), estimates, looks[line.name].colour))
            ax.set_ylabel(plotstyle.axis(metric))
            _scale(ax.yaxis, metric, points.values(), ticks=5)
            for intervals in drawn:
                has_arrows |= _arrows(ax.yaxis, *intervals)
            if not numeric or np.diff(np.sort(places)).min(initial=np.inf) >= _TICKS_APART * np.ptp(places):
                ax.set_xticks(places, [str(value) for value in values])
            if not numeric:
                ax.set_xlim(-0.5, len(values) - 0.5)
                ax.grid(visible=False, axis="x")
        for ax in lowest(axes):
            ax.set_xlabel(with_unit(key))
        joined = {"linestyle": "-" if numeric else ""}
        plotstyle.place_legend(figure, [plotstyle.mark(look, name, **joined) for name, look in looks.items()])
        explained(figure, [len(summaries) for summaries in points.values()], has_arrows=has_arrows)
    return figure
