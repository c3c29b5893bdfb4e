"""Plots of anyone's own scenario: one run, several methods side by side, a parameter swept."""

import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from meanflock.groundstation import statistics
from meanflock.groundstation.plots import mission, plotstyle
from meanflock.groundstation.plots.curves import MAX_POINTS, Curves, grid, line
from meanflock.groundstation.results.quantities import COMPARED, FIELDS, PHI_G, number, with_unit
from meanflock.groundstation.results.run_folder import EVENTS, flown_rows
from meanflock.groundstation.results.series import diagnostics_in

log = logging.getLogger("meanflock.plots")

Floats = NDArray[np.float64]
Summaries = Sequence[Mapping[str, Any]]  # of runs that differ in their seed

FLIGHTS_BELOW = 0.32  # of the distance of two rows
_MAX_SEGMENTS = 60_000  # of all paths


def write(figures: Mapping[str, Figure], out: Path) -> list[Path]:
    """Writes every figure as `out`/name.png and .svg.

    Raises:
        BadInput: the folder cannot be made.
        RunFailed: the disk is full.
    """
    return [path for name, made in figures.items() for path in plotstyle.save(made, out, name)]


# -- one run --------------------------------------------------------------------------------------------------------


def plot_run(folder: Path) -> dict[str, Figure]:
    """`paths` and `curves` of the run in `folder`, from its timeseries.parquet, scenario.toml and events.jsonl.

    Raises:
        BadInput: no run there, or one that never wrote a row.
    """
    table = flown_rows(folder)
    flown = mission.flown(folder)
    with plotstyle.style():
        return {"paths": _run_paths(table, flown, folder), "curves": _run_curves(table, flown)}


def _events(folder: Path, kind: str) -> list[dict[str, Any]]:
    """The events of a kind; those that can be read, where the file is cut or damaged."""
    path = folder / EVENTS
    rows = []
    for text in path.read_bytes().splitlines() if path.is_file() else ():
        try:
            row = json.loads(text)
            rows.append({"tick": int(row["tick"]), "kind": str(row["kind"]), "uavs": [int(k) for k in row["uavs"]]})
        except (ValueError, TypeError, KeyError):
            continue  # the last line of a run that was killed, for example
    return [row for row in rows if row["kind"] == kind]


def _run_paths(table: pa.Table, flown: mission.Flown, folder: Path) -> Figure:
    x, y = grid(table, "x_m"), grid(table, "y_m")
    step = max(1, len(x) // MAX_POINTS, len(x) * x.shape[1] // _MAX_SEGMENTS)
    position = np.stack([x, y], axis=-1)[::step]
    made = plotstyle.figure(plotstyle.COLUMN_IN * 1.1, 3.9)
    ax = made.subplots()
    shaded = PHI_G in diagnostics_in(table.schema)
    plotstyle.paths(ax, position, grid(table, PHI_G)[::step] if shaded else plotstyle.colour(flown.method))
    ax.plot(x[0], y[0], linestyle="", marker="s", markersize=2.0, color=plotstyle.PALE, label="start")
    ax.plot(x[-1], y[-1], linestyle="", marker="o", markersize=2.4, color=plotstyle.INK, label="end")
    collisions = _places(folder, "collision", x, y)
    if (counted := int(line(table, "collisions")[-1])) != len(collisions):
        log.warning("%s: %d of %d collisions; the others are not marked", folder / EVENTS, len(collisions), counted)
    ax.plot(*collisions.T, **plotstyle.STAR, label=f"collisions: {counted}")
    if len(flown.obstacles):
        hits = _places(folder, "hit", x, y)
        ax.plot(*hits.T, **plotstyle.CROSS, label=f"obstacle hits: {len(hits)}")
    mission.draw(ax, flown)
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.05)
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    end = line(table, "sim_time_s")[-1]
    arrived = int(line(table, "arrived")[-1])
    who = f"{flown.method}, seed {flown.seed}: " if flown.method else ""
    plotstyle.titled(ax, "", f"{who}{arrived} of {x.shape[1]} arrived in {end:.0f} s")
    made.legend(loc="outside lower center", ncols=5, handletextpad=0.2, columnspacing=1.2)
    if shaded:
        label = plotstyle.tex(f"{FIELDS[PHI_G].name} as a UAV reports it ({FIELDS[PHI_G].unit})")
        made.colorbar(ScalarMappable(**plotstyle.PHI_G), ax=ax, extend="both", label=label)
    return made


def _places(folder: Path, kind: str, x: Floats, y: Floats) -> Floats:
    """Where events of a kind happened, (K, 2), m; x and y are `(T, N)`."""
    places = [
        position_of(x, y, event["tick"], event["uavs"])
        for event in _events(folder, kind)
        if 0 <= event["tick"] < len(x) and event["uavs"] and all(0 <= uav < x.shape[1] for uav in event["uavs"])
    ]
    return np.array(places).reshape(-1, 2)


def position_of(x: Floats, y: Floats, tick: int, uavs: Sequence[int]) -> tuple[float, float]:
    """Where UAVs are on average in a tick, m; x and y are `(T, N)`."""
    return float(x[tick, uavs].mean()), float(y[tick, uavs].mean())


def _run_curves(table: pa.Table, flown: mission.Flown) -> Figure:
    curves = Curves(table, plotstyle.colour(flown.method))
    panels = curves.panels()
    rows = -(-len(panels) // 2)
    made = plotstyle.figure(plotstyle.PAGE_IN, 1.9 * rows)
    axes = made.subplots(rows, 2, sharex=True, squeeze=False)
    for at, (panel, ax) in enumerate(zip(panels, axes.ravel(), strict=False)):
        panel.draw(ax)
        plotstyle.titled(ax, plotstyle.letter(at), panel.title)
        ax.set_ylabel(panel.label)
        ax.margins(x=0.0)
    if len(panels) < axes.size:
        axes[-1, -1].set_visible(False)
        axes[-2, -1].xaxis.set_tick_params(labelbottom=True)
        axes[-2, -1].set_xlabel(plotstyle.axis("t_s"))
    for ax in axes[-1]:
        ax.set_xlabel(plotstyle.axis("t_s"))
    return made


# -- several methods, and sweeps ------------------------------------------------------------------------------------


def _panels(metrics: Sequence[str], row_in: float, more_in: float, share: str) -> tuple[Figure, list[Axes]]:
    """A figure with two panels a row, a metric each, which share an axis; rows are so high, and all so much more."""
    rows = -(-len(metrics) // 2)
    made = plotstyle.figure(plotstyle.PAGE_IN, rows * row_in + more_in)
    axes = list(made.subplots(rows, 2, sharex=share == "x", sharey=share == "y").ravel())
    for letter, metric, ax in zip("abcdefghij", metrics, axes, strict=False):
        plotstyle.titled(ax, letter, FIELDS[metric].remarked)
    for ax in axes[len(metrics) :]:
        ax.set_visible(False)
    return made, axes


def plot_compare(runs: Mapping[str, Summaries]) -> Figure:
    """A panel a metric, a method a row: the mean with its 95 % interval over seeds, and below it a pale dot a run.

    runs: by method the summaries of its runs.
    """
    methods, looks = list(runs), plotstyle.looks(runs)
    with plotstyle.style():
        made, axes = _panels(COMPARED, 0.75 + 0.22 * len(methods), 0.3, "y")
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
            _never_negative(ax)
        _explained(made, [len(summaries) for summaries in runs.values()], "pale: single flights; ")
    return made


def _never_negative(ax: Axes) -> None:
    """Begins the x axis just left of 0 where it would begin farther left: no metric here is negative."""
    left, right = ax.get_xlim()
    if left <= 0.0:
        right = max(right, 1.0) if ax.dataLim.x1 <= 0.0 else right
        ax.set_xlim(-0.03 * right, 1.03 * right)


def _row(ax: Axes, place: int, values: Floats, look: plotstyle.Look) -> None:
    """A method's mean and its interval, and its flights below them, where neither covers them."""
    estimate = statistics.mean(values)
    pale: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3, "markeredgewidth": 0.0, "alpha": 0.45}
    ax.plot(values, np.full(len(values), place + FLIGHTS_BELOW), color=look.colour, **pale)
    if estimate.bounded:
        ax.plot([max(estimate.low, 0.0), estimate.high], [place, place], color=look.colour, linewidth=2.0)
    mean: dict[str, Any] = {"marker": look.marker, "markersize": 6, "markeredgecolor": "white"}
    ax.plot([estimate.value], [place], color=look.colour, **mean)


def _explained(made: Figure, flights: Sequence[int], before: str = "") -> None:
    """What points and bars are, below all panels."""
    least, most = min(flights), max(flights)
    said = f"{before}mean and 95 % interval over {least if least == most else f'{least} to {most}'} flights"
    made.supxlabel(said if most > 1 else "one flight each: no interval", fontsize=7, color=plotstyle.INK)


def plot_sweep(key: str, points: Mapping[Any, Mapping[str, Summaries]]) -> Figure:
    """A panel a metric along the swept key: mean over seeds with 95 % interval, a line a method.

    Args:
        key: what was swept, as `--set` calls it; points: value → method → summaries. Values that are not all numbers
            are put side by side.
    """
    values = list(points)
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    x = np.array(values if numeric else range(len(values)), dtype=np.float64)
    methods = list(dict.fromkeys(method for runs in points.values() for method in runs))
    looks = plotstyle.looks(methods)
    with plotstyle.style():
        made, axes = _panels(COMPARED[:4], 1.75, 0.65, "x")
        for metric, ax in zip(COMPARED[:4], axes, strict=True):
            for place, method in enumerate(methods):
                beside = 0.012 * (x.max() - x.min()) * (place - (len(methods) - 1) / 2)
                estimates = [
                    statistics.mean([number(summary, metric) for summary in runs.get(method, ())])
                    for runs in points.values()
                ]
                plotstyle.dots(ax, looks[method], x + beside, estimates)
            ax.set_ylabel(plotstyle.axis(metric))
            if metric.startswith("payload_bits"):
                plotstyle.bit_axis(ax.yaxis)
            if not numeric:
                ax.set_xticks(x, [str(value) for value in values])
        for ax in axes[-2:]:
            ax.set_xlabel(with_unit(key))
        plotstyle.legend(made, methods, markers=True, looks=looks)
        _explained(made, [len(summaries) for runs in points.values() for summaries in runs.values()])
    return made
