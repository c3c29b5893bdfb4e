"""Figures 5, 6 and 7: four criteria along a grid, mean over seeds with 95 % intervals."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from meanflock.groundstation import statistics
from meanflock.groundstation.plots import plotstyle
from meanflock.groundstation.results.quantities import FIELDS
from meanflock.studies.paper.view import COORDINATE, View

CRITERIA = tuple(
    (metric, FIELDS[metric].remarked) for metric in ("energy_mean_J", "t_avg_censored_s", "phi_A_tavg", "phi_C_tavg")
)
SHARERS = ("mfgfl-h", "mfgfl-f", "mfgfl-hf")
COMPARED = ("hjb", *SHARERS)


def _four_panels(view: View, experiment: str, methods: Sequence[str]) -> Figure | None:
    points = view.points(experiment)
    if not points:
        return None
    made = plotstyle.figure(plotstyle.COLUMN_IN, 4.1)
    axes = made.subplots(2, 2, sharex=True).ravel()
    spread = 0.012 * (points[-1] - points[0])  # methods side by side, so that intervals do not hide each other
    for letter, (metric, title), ax in zip("abcd", CRITERIA, axes, strict=True):
        for k, method in enumerate(methods):
            values = [list(view.cell(experiment, method, point).by_seed(metric).values()) for point in points]
            x = np.array(points) + spread * (k - (len(methods) - 1) / 2)
            plotstyle.dots(ax, plotstyle.look(method), x, list(map(statistics.mean, values)))
        if metric == "phi_C_tavg":
            sizes = view.runs.where(experiment=experiment)
            floor = [1.0 / sizes.where(**{COORDINATE[experiment]: point})["uavs"][0] for point in points]
            ax.plot(points, floor, color=plotstyle.PALE, linestyle=":", linewidth=1.0, zorder=1)
        plotstyle.titled(ax, letter, title)
        ax.set_ylabel(plotstyle.axis(metric))
        ax.set_xticks(points)
    for ax in axes[2:]:
        labels = ax.set_xticks(points, [f"{point:g}" for point in points])
        if len(points) > 1 and points[1] - points[0] < 0.12 * (points[-1] - points[0]):
            labels[0].label1.set_horizontalalignment("right")
        ax.set_xlabel(plotstyle.axis(COORDINATE[experiment]))
    plotstyle.legend(made, methods, markers=True)
    return made


def against_uavs(view: View) -> Figure | None:
    """Figure 5: against N."""
    return _four_panels(view, "uavs", COMPARED)


def against_period(view: View) -> Figure | None:
    """Figure 6: against n0, of the methods that have rounds."""
    return _four_panels(view, "period", SHARERS)


def against_wind(view: View) -> Figure | None:
    """Figure 7: against σ_wind."""
    return _four_panels(view, "wind", COMPARED)
