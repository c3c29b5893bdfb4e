"""Figures 3 to 7: S0 over time, and four criteria along a grid."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import special

from meanflock.results import statistics
from meanflock.results.plots import plotstyle
from meanflock.results.quantities import FIELDS
from research.reproduction.tables import COORDINATE, Frame, View

# -- along a grid ------------------------------------------------------------------------------------------------------


CRITERIA = tuple(
    (metric, FIELDS[metric].remarked) for metric in ("energy_mean_J", "t_avg_censored_s", "phi_A_tavg", "phi_C_tavg")
)
SHARERS = ("mfgfl-h", "mfgfl-f", "mfgfl-hf")
COMPARED = ("hjb", *SHARERS)


def _four_panels(view: View, experiment: str, methods: Sequence[str]) -> Figure | None:
    points = view.points(experiment)
    if not points:
        return None
    figure = plotstyle.figure(plotstyle.COLUMN_IN, 4.1)
    axes = figure.subplots(2, 2, sharex=True).ravel()
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
        ax.set_ylabel(plotstyle.tex("T_avg (s)") if metric == "t_avg_censored_s" else plotstyle.axis(metric))
        ax.set_xticks(points)
    for ax in axes[2:]:
        labels = ax.set_xticks(points, [f"{point:g}" for point in points])
        if len(points) > 1 and points[1] - points[0] < 0.12 * (points[-1] - points[0]):
            labels[0].label1.set_horizontalalignment("right")
        ax.set_xlabel(plotstyle.axis(COORDINATE[experiment]))
    plotstyle.legend(figure, methods, markers=True)
    return figure


def against_uavs(view: View) -> Figure | None:
    """Figure 5: against N."""
    return _four_panels(view, "uavs", COMPARED)


def against_period(view: View) -> Figure | None:
    """Figure 6: against n0, for the methods with rounds."""
    return _four_panels(view, "period", SHARERS)


def against_wind(view: View) -> Figure | None:
    """Figure 7: against σ_wind."""
    return _four_panels(view, "wind", COMPARED)


# -- over time ---------------------------------------------------------------------------------------------------------


Floats = NDArray[np.float64]

PAPER_TIME_S = 175.0
HJB_BOUND, FPK_BOUND = 1.5, 0.02


@dataclass(frozen=True, slots=True)
class Bundle:
    """Curves of many seeds: times (T,), and a row for each seed, (seeds, T)."""

    times: Floats
    rows: Floats

    @property
    def mean(self) -> Floats:
        """Mean over the seeds with a finite value, `(T,)`; NaN without any."""
        known = np.isfinite(self.rows)
        count = known.sum(axis=0)
        total = np.where(known, self.rows, 0.0).sum(axis=0)
        return np.divide(total, count, out=np.full(len(self.times), np.nan), where=count > 0)

    @property
    def half(self) -> Floats:
        """Half the width of the 95 % interval of the mean, `(T,)`; zero with one seed."""
        n = len(self.rows)
        if n < 2:
            return np.zeros(len(self.times))
        return np.asarray(special.stdtrit(n - 1, 0.975) * self.rows.std(axis=0, ddof=1) / np.sqrt(n))


def bundle(frame: Frame, metric: str) -> Bundle:
    """The curves of `metric`, from rows (seed, t_s)."""
    seeds, seed_row = np.unique(frame["seed"], return_inverse=True)
    times, time_column = np.unique(frame["t_s"], return_inverse=True)
    rows = np.full((len(seeds), len(times)), np.nan)
    rows[seed_row, time_column] = frame[metric]
    return Bundle(times, rows)


def _with_interval(ax: Axes, method: str, curves: Bundle) -> None:
    plotstyle.curve(ax, method, curves.times, curves.mean, curves.mean - curves.half, curves.mean + curves.half)


def six_panels(view: View) -> Figure | None:
    """Figure 3: energy, bits, φ_A, φ_C, speed, distance."""
    if not len(view.series):
        return None
    figure = plotstyle.figure(plotstyle.COLUMN_IN, 5.7)
    axes = figure.subplots(3, 2, sharex=True)
    energy, bits, alignment, risk, speed, distance = axes.ravel()
    for method in COMPARED:
        frame = view.series.where(experiment="s0", method=method)
        if not len(frame):
            continue
        mean, std = bundle(frame, "energy_trip_mean_J"), bundle(frame, "energy_trip_std_J").mean
        plotstyle.curve(energy, method, mean.times, mean.mean, mean.mean - std, mean.mean + std)
        _with_interval(bits, method, bundle(frame, "bits"))
        _with_interval(alignment, method, bundle(frame, "phi_A"))
        _with_interval(risk, method, bundle(frame, "phi_C"))
        _with_interval(speed, method, bundle(frame, "speed_mean_m_s"))
        for end in ("speed_max_m_s", "speed_min_m_s"):
            curves = bundle(frame, end)
            speed.plot(curves.times, curves.mean, color=plotstyle.colour(method), linewidth=0.6, alpha=0.6)
        _with_interval(distance, method, bundle(frame, "distance_mean_m"))
    panels = (
        (energy, "a", f"{FIELDS['energy_trip_mean_J'].name}, mean ± std", plotstyle.axis("energy_trip_mean_J")),
        (bits, "b", FIELDS["payload_bits.total"].name, plotstyle.axis("bits")),
        (alignment, "c", FIELDS["phi_A"].remarked, plotstyle.axis("phi_A")),
        (risk, "d", FIELDS["phi_C"].name, plotstyle.axis("phi_C")),
        (speed, "e", "speed: mean, max, min", plotstyle.axis("speed_mean_m_s")),
        (distance, "f", FIELDS["distance_mean_m"].name, plotstyle.axis("distance_mean_m")),
    )
    for ax, letter, title, label in panels:
        plotstyle.titled(ax, letter, title)
        ax.set_ylabel(label)
        ax.axvline(PAPER_TIME_S, color=plotstyle.PALE, linewidth=0.8, linestyle=":")
        ax.margins(x=0.0)
    plotstyle.log_axis(bits)
    speed.set_ylim(bottom=0.0)
    for ax in axes[-1]:
        ax.set_xlabel(plotstyle.axis("t_s"))
    plotstyle.legend(figure, COMPARED)
    return figure


def residuals(view: View) -> Figure | None:
    """Figure 4: |e_H| and |e_F|."""
    if not len(view.series):
        return None
    figure = plotstyle.figure(plotstyle.COLUMN_IN, 2.45)
    value, density = figure.subplots(1, 2)
    for ax, prefix in ((value, "hjb"), (density, "fpk")):
        for method in COMPARED:
            frame = view.series.where(experiment="s0", method=method)
            if not len(frame) or (prefix == "fpk" and method == "hjb"):
                continue
            largest = bundle(frame, f"{prefix}_abs_max")
            ax.plot(largest.times, largest.mean, color=plotstyle.colour(method), linewidth=0.5, alpha=0.6)
            mean = bundle(frame, f"{prefix}_abs_mean")
            plotstyle.curve(ax, method, mean.times, mean.mean)
        plotstyle.log_axis(ax)
        ax.set_xlabel(plotstyle.axis("t_s"))
        ax.margins(x=0.0)
    for ax, bound in ((value, HJB_BOUND), (density, FPK_BOUND)):
        ax.axhline(bound, color=plotstyle.INK, linewidth=1.0, linestyle=":", zorder=4)
    plotstyle.titled(value, "a", f"{FIELDS['hjb_residual'].name}; < {HJB_BOUND:g}")
    plotstyle.titled(density, "b", f"{FIELDS['fpk_residual'].name}; < {FPK_BOUND:g}")
    value.set_ylabel(plotstyle.axis("hjb_residual"))
    density.set_ylabel(plotstyle.axis("fpk_residual"))
    plotstyle.legend(figure, COMPARED)
    return figure
