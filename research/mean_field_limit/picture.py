"""The picture of docs/mean-field-limit.md: distances over N beside lines of the expected exponent, and deviations."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from meanflock.results import statistics
from meanflock.results.plots import plotstyle
from meanflock.studies import published
from research.mean_field_limit.cases import DEVIATIONS, DISTANCES, INTERACTIONS, REFERENCE, Row
from research.mean_field_limit.flights import BEGINNING
from research.mean_field_limit.page import EXPECTED, changed, of, sizes

FOLDER, NAME = published.DOCS / "pictures", "mean-field-limit"
LOOKS = plotstyle.look("mfgfl-hf"), plotstyle.look("hjb")  # of the two lines of a panel of distances
RISES = {"plan": 9, "cruise": -14, "mfg": 9}  # of the labels of deviations, points: `plan` and `cruise` lie close
LABELS = dict(
    zip((*DISTANCES, *INTERACTIONS), ("positions", "velocities", "true states", "learned density"), strict=True)
)


def draw(rows: Sequence[Row]) -> None:
    """Writes the picture of these flights."""
    with plotstyle.style():
        figure = plotstyle.figure(plotstyle.PAGE_IN, 2.7)
        left, middle, right = figure.subplots(1, 3)
        _distances(left, DISTANCES, rows)
        _distances(middle, INTERACTIONS, rows)
        _deviations(right, rows)
        left.set(ylabel="sliced $W_1$ (m; m/s)")
        middle.set(ylabel="RMS difference of $\\phi_G$ (1/s$^2$)")
        for letter, ax, title in zip(
            "abc", (left, middle, right), ("states", "interaction", "one UAV deviates"), strict=True
        ):
            plotstyle.titled(ax, letter, title)
            ax.set(xscale="log", xlabel="number of UAVs $N$")
        plotstyle.save(figure, FOLDER, NAME, ("png",))


def _distances(ax: Axes, names: Sequence[str], rows: Sequence[Row]) -> None:
    swarms = np.array([uavs for uavs in sizes(rows, BEGINNING) if uavs != REFERENCE.uavs], dtype=float)
    for name, look in zip(names, LOOKS, strict=True):
        means = [statistics.mean([row[name][-1] for row in of(rows, int(uavs), BEGINNING)]) for uavs in swarms]
        plotstyle.dots(ax, look, swarms, means)
        middle = len(swarms) // 2
        line = means[middle].value * (swarms / swarms[middle]) ** EXPECTED
        ax.plot(swarms, line, color=plotstyle.PALE, linestyle=(0, (4, 2)), linewidth=1.0, zorder=1)
        _label(ax, LABELS[name], swarms[0], means[0].value, look.colour, 4)
    plotstyle.log_axis(ax)


def _deviations(ax: Axes, rows: Sequence[Row]) -> None:
    for name in DEVIATIONS:
        swarms, look = sizes(rows, name), plotstyle.look(name)
        changes = [changed(rows, uavs, name, "last_cost_m") for uavs in swarms]
        plotstyle.dots(ax, look, np.array(swarms, dtype=float), changes)
        for uavs, change in list(zip(swarms, changes, strict=True))[:1]:
            _label(ax, name, uavs, change.value, look.colour, RISES[name])
    ax.axhline(0.0, color=plotstyle.INK, linewidth=0.7)
    ax.margins(y=0.12)
    ax.set(ylabel="change of own cost (m)")


def _label(ax: Axes, text: str, x: float, y: float, colour: str, rise: int) -> None:
    """Label of a line, some points above its first mark."""
    ax.annotate(text, (x, y), (6, rise), textcoords="offset points", color=colour)
