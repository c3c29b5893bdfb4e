"""Plots of anyone's own scenario: one run, several methods side by side, a parameter swept."""

import json
import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from channel.meter import TRAFFIC
from groundstation import plotstyle
from groundstation.paper import statistics
from groundstation.results import EVENTS, SCENARIO, TIMESERIES
from swarm.errors import BadInput
from swarm.scenario import Scenario, load

log = logging.getLogger("meanflock.plots")

Floats = NDArray[np.float64]
Summaries = Sequence[Mapping[str, Any]]  # of runs that differ in their seed

COMPARED = (  # key of a summary, title of its panel
    ("t_avg_s", "travel time"),
    ("energy_mean_J", "motion energy"),
    ("payload_bits.total", "payload"),
    ("phi_A", "velocity alignment"),
    ("phi_C_distinct", "collision risk"),
    ("collisions", "collisions"),
)
_PHI = LogNorm(1e-3, 1e0, clip=True)
_MAX_POINTS = 1500  # of a curve, instants of a path
_MAX_SEGMENTS = 60_000  # of all paths


def write(figures: Mapping[str, Figure], out: Path) -> list[Path]:
    """Writes every figure as `out`/name.png and .svg.

    Raises:
        BadInput: the folder cannot be written.
    """
    try:
        return [path for name, made in figures.items() for path in plotstyle.save(made, out, name)]
    except OSError as error:
        raise BadInput(f"--out {out}: {error.strerror}; name a folder that can be written") from error


# -- one run --------------------------------------------------------------------------------------------------------


def plot_run(folder: Path) -> dict[str, Figure]:
    """`paths` and `curves` of the run in `folder`, from its timeseries.parquet, scenario.toml and events.jsonl.

    Raises:
        BadInput: no run there, or one that never wrote a row.
    """
    path = folder / TIMESERIES
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise BadInput(f"{path}: {error}; name the folder of a run") from error
    if table.num_rows < 2:
        raise BadInput(f"{path}: nothing was flown; name the folder of a run that took off")
    scenario = load(folder / SCENARIO) if (folder / SCENARIO).is_file() else Scenario()
    with plotstyle.style():
        return {"paths": _run_paths(table, scenario, folder), "curves": _run_curves(table, scenario)}


def _grid(table: pa.Table, column: str) -> Floats:
    """A list column as `(T, N)`."""
    values = table.column(column).combine_chunks()
    return np.asarray(values.values.to_numpy(zero_copy_only=False), dtype=np.float64).reshape(table.num_rows, -1)


def _line(table: pa.Table, column: str) -> Floats:
    return np.asarray(table.column(column).to_numpy(), dtype=np.float64)


def _events(folder: Path, kind: str) -> list[dict[str, Any]]:
    """The events of a kind; those that can be read, where the file is cut or damaged."""
    path = folder / EVENTS
    rows = []
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        try:
            row = json.loads(line)
            rows.append({"tick": int(row["tick"]), "kind": str(row["kind"]), "uavs": [int(k) for k in row["uavs"]]})
        except (ValueError, TypeError, KeyError):
            continue  # the last line of a run that was killed, for example
    return [row for row in rows if row["kind"] == kind]


def _run_paths(table: pa.Table, scenario: Scenario, folder: Path) -> Figure:
    x, y, phi = _grid(table, "x_m"), _grid(table, "y_m"), _grid(table, "phi_G")
    step = max(1, len(x) // _MAX_POINTS, len(x) * x.shape[1] // _MAX_SEGMENTS)
    position = np.stack([x, y], axis=-1)[::step]
    segments = np.stack([position[:-1], position[1:]], axis=-2).reshape(-1, 2, 2)
    made = plotstyle.figure(plotstyle.COLUMN_IN, 3.7)
    ax = made.subplots()
    lines = LineCollection(list(segments), linewidths=0.7, rasterized=True, norm=_PHI, cmap="viridis")
    lines.set_array(phi[::step][1:].ravel())
    ax.add_collection(lines)
    ax.plot(x[0], y[0], linestyle="", marker="s", markersize=2.0, color=plotstyle.PALE, label="start")
    ax.plot(x[-1], y[-1], linestyle="", marker="o", markersize=2.4, color=plotstyle.INK, label="end")
    met = [
        (event["tick"], event["uavs"])
        for event in _events(folder, "collision")
        if 0 <= event["tick"] < len(x) and event["uavs"] and all(0 <= uav < x.shape[1] for uav in event["uavs"])
    ]
    if (counted := int(_line(table, "collisions")[-1])) != len(met):
        log.warning("%s: %d of %d collisions; the others are not marked", folder / EVENTS, len(met), counted)
    places = np.array([position_of(x, y, tick, uavs) for tick, uavs in met]).reshape(-1, 2)
    ax.plot(places[:, 0], places[:, 1], **plotstyle.STAR, label=f"collisions: {counted}")
    ax.add_patch(Circle((0.0, 0.0), scenario.destination.radius, fill=False, edgecolor=plotstyle.INK, linewidth=1.1))
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.05)
    ax.set_xlabel("$x$ (m)")
    ax.set_ylabel("$y$ (m)")
    end = _line(table, "sim_time_s")[-1]
    arrived = int(_line(table, "arrived")[-1])
    plotstyle.titled(
        ax,
        "",
        f"{plotstyle.name(scenario.method)}, seed {scenario.seed}: {arrived} of {x.shape[1]} arrived in {end:.0f} s",
    )
    made.legend(loc="outside lower center", ncols=3, handletextpad=0.2)
    made.colorbar(ScalarMappable(_PHI, "viridis"), ax=ax, extend="both", label=r"$\phi_G$ a UAV acts on (1/s$^2$)")
    return made


def position_of(x: Floats, y: Floats, tick: int, uavs: Sequence[int]) -> tuple[float, float]:
    """Where UAVs are on average in a tick, m; x and y are `(T, N)`."""
    return float(x[tick, uavs].mean()), float(y[tick, uavs].mean())


def _run_curves(table: pa.Table, scenario: Scenario) -> Figure:
    step = max(1, table.num_rows // _MAX_POINTS)
    times = _line(table, "sim_time_s")[::step]
    tone = plotstyle.colour(scenario.method)

    def spread(ax: Axes, values: Floats) -> None:
        rows = values[::step]
        ax.fill_between(times, rows.min(axis=-1), rows.max(axis=-1), color=tone, alpha=0.18, linewidth=0)
        ax.plot(times, rows.mean(axis=-1), color=tone)

    made = plotstyle.figure(plotstyle.COLUMN_IN, 7.2)
    axes = made.subplots(4, 2, sharex=True)
    energy, speed, bits, alignment, risk, arrived, value, density = axes.ravel()
    spread(energy, _grid(table, "energy_J"))
    spread(speed, np.hypot(_grid(table, "vx_m_s"), _grid(table, "vy_m_s")))
    for ax, columns in (
        (bits, tuple(f"{name}_bits" for name in TRAFFIC.values())),
        (alignment, ("phi_A",)),
        (risk, ("phi_C",)),
        (arrived, ("arrived",)),
    ):
        kept = [column for column in columns if column in table.column_names]  # older runs have no relays
        ax.plot(times, sum(_line(table, column)[::step] for column in kept), color=tone)
    arrived.plot(times, _line(table, "collisions")[::step], color="#CC2222", linewidth=1.0, label="collisions")
    arrived.legend(loc="upper left", fontsize=7)
    for ax, column in ((value, "hjb_residual"), (density, "fpk_residual")):
        mean = np.abs(_grid(table, column)[::step]).mean(axis=-1)
        if mean.max() > 0:
            ax.plot(times, np.where(mean > 0, mean, np.nan), color=tone, linewidth=1.0)
            plotstyle.log_axis(ax)
        else:
            ax.annotate("no density is learned", (0.5, 0.5), xycoords="axes fraction", ha="center")
            ax.set_yticks([])
    panels = (
        (energy, "energy: mean, max, min", "energy (J)"),
        (speed, "speed: mean, max, min", "speed (m/s)"),
        (bits, "payload so far", "payload (bit)"),
        (alignment, "velocity alignment", plotstyle.axis("phi_A")),
        (risk, "collision risk", plotstyle.axis("phi_C")),
        (arrived, "arrived, collisions", "UAVs, pairs"),
        (value, "value learner, mean", "$|e_H|$ (m/s)"),
        (density, "density learner, mean", "$|e_F|$ (1/s)"),
    )
    for letter, (ax, title, label) in zip("abcdefgh", panels, strict=True):
        plotstyle.titled(ax, letter, title)
        ax.set_ylabel(label)
        ax.margins(x=0.0)
    plotstyle.bit_axis(bits.yaxis)
    for ax in axes[-1]:
        ax.set_xlabel(plotstyle.axis("t_s"))
    return made


# -- several methods, and sweeps ------------------------------------------------------------------------------------


def number(summary: Mapping[str, Any], key: str) -> float:
    """A number of a summary by its dotted key; NaN where it is unknown.

    Raises:
        BadInput: a summary has no such number.
    """
    value: Any = summary
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            raise BadInput(f"{key}: a summary has no such entry")
        value = value[part]
    if value is None:
        return math.nan
    if isinstance(value, str | Mapping | Sequence):
        raise BadInput(f"{key}: not a number")
    return float(value)


def _label(key: str) -> str:
    return plotstyle.axis(key.removesuffix(".total"))


def plot_compare(runs: Mapping[str, Summaries], metrics: Sequence[tuple[str, str]] = COMPARED) -> Figure:
    """A panel a metric, a method a row: every run as a pale dot, the mean with its 95 % interval over seeds.

    Args:
        runs: method → the summaries of its runs. metrics: (key of a summary, title).
    """
    methods = list(runs)
    columns = 2 if len(metrics) > 1 else 1
    rows = -(-len(metrics) // columns)
    with plotstyle.style():
        made = plotstyle.figure(plotstyle.COLUMN_IN, rows * (0.75 + 0.2 * len(methods)) + 0.1)
        axes = made.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for letter, (key, title), ax in zip("abcdefghij", metrics, axes, strict=False):
            for place, method in enumerate(methods):
                values = np.array([number(summary, key) for summary in runs[method]])
                estimate = statistics.mean(values)
                tone = plotstyle.colour(method)
                ax.plot(
                    values, np.full(len(values), place), linestyle="", marker="o", markersize=3, color=tone, alpha=0.3
                )
                if estimate.bounded:
                    ax.plot([estimate.low, estimate.high], [place, place], color=tone, linewidth=2.0)
                marker = plotstyle.MARKERS.get(method, "o")
                ax.plot([estimate.value], [place], marker=marker, markersize=6, color=tone, markeredgecolor="white")
            ax.set_ylim(len(methods) - 0.5, -0.5)
            ax.set_yticks(range(len(methods)), [plotstyle.name(method) for method in methods])
            ax.grid(visible=False, axis="y")
            plotstyle.titled(ax, letter, title)
            ax.set_xlabel(_label(key))
            if key.startswith("payload_bits"):
                plotstyle.bit_axis(ax.xaxis)
        for ax in axes[len(metrics) :]:
            ax.set_visible(False)
    return made


def plot_sweep(
    key: str, points: Mapping[Any, Mapping[str, Summaries]], metrics: Sequence[tuple[str, str]] = COMPARED[:4]
) -> Figure:
    """A panel a metric along the swept key: mean over seeds with 95 % interval, a line a method.

    Args:
        key: what was swept, as `--set` calls it; points: value → method → summaries. Values that are not all numbers
            are put side by side.
    """
    values = list(points)
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    x = np.array(values if numeric else range(len(values)), dtype=np.float64)
    methods = list(dict.fromkeys(method for runs in points.values() for method in runs))
    columns = 2 if len(metrics) > 1 else 1
    rows = -(-len(metrics) // columns)
    with plotstyle.style():
        made = plotstyle.figure(plotstyle.COLUMN_IN, 1.75 * rows + 0.45)
        axes = made.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for letter, (metric, title), ax in zip("abcdefghij", metrics, axes, strict=False):
            for place, method in enumerate(methods):
                beside = 0.012 * (x.max() - x.min()) * (place - (len(methods) - 1) / 2)
                estimates = [
                    statistics.mean([number(summary, metric) for summary in runs.get(method, ())])
                    for runs in points.values()
                ]
                middle, low, high = (np.array([getattr(e, end) for e in estimates]) for end in ("value", "low", "high"))
                plotstyle.dots(ax, method, x + beside, middle, low, high)
            plotstyle.titled(ax, letter, title)
            ax.set_ylabel(_label(metric))
            if metric.startswith("payload_bits"):
                plotstyle.bit_axis(ax.yaxis)
            if not numeric:
                ax.set_xticks(x, [str(value) for value in values])
        for ax in axes[len(metrics) :]:
            ax.set_visible(False)
        for ax in axes[-columns:]:
            ax.set_xlabel(swept(key))
        plotstyle.legend(made, methods, markers=True)
    return made


def swept(key: str) -> str:
    """The axis of a swept key: its name and, where the scenario knows it, its unit."""
    return UNITS.get(key, key)


UNITS = {
    "uavs": "number of UAVs $N$",
    "dt": "dt (s)",
    "duration": "duration (s)",
    "wind.sigma": r"wind.sigma (m s$^{-1}$ s$^{-1/2}$)",
    "wind.drag": "wind.drag (1/s)",
    "start.spacing": "start.spacing (m)",
    "start.height": "start.height (m)",
    "destination.radius": "destination.radius (m, m/s)",
    "cost.c1": r"cost.c1 (s$^2$/m$^2$)",
    "cost.c3": r"cost.c3 (s$^4$/m$^2$)",
    "cost.epsilon": r"cost.epsilon (m$^2$)",
    "learner.kappa": "learner.kappa (1/s)",
    "learner.position_scale": "learner.position_scale (m)",
    "learner.velocity_scale": "learner.velocity_scale (m/s)",
    "federation.period": "federation.period (ticks)",
    "federation.state_period": "federation.state_period (ticks)",
    "radio.tx_power_dbm": "radio.tx_power_dbm (dBm)",
    "radio.bandwidth_hz": "radio.bandwidth_hz (Hz)",
    "radio.target_snr_db": "radio.target_snr_db (dB)",
    "radio.coherence_time_s": "radio.coherence_time_s (s)",
    "radio.latency_threshold_slots": "radio.latency_threshold_slots (slots)",
    "radio.range_m": "radio.range_m (m)",
    "metrics.collision_radius": "metrics.collision_radius (m)",
    "metrics.hazard_radius": "metrics.hazard_radius (m)",
}
