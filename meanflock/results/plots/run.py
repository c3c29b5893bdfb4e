"""Plots of one run: paths on the map, and a panel for every quantity of its time series.

They need neither the controller nor the plug-ins of the run.
"""

import json
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from numpy.typing import NDArray

from meanflock.channel.meter import TRAFFIC
from meanflock.results.event_log import stored_lines
from meanflock.results.flown import FlownKeys, flown_keys
from meanflock.results.plots import plotstyle
from meanflock.results.quantities import FIELDS, PHI_G, POSITION, VELOCITY, quantity
from meanflock.results.run_folder import EVENTS, flown_rows
from meanflock.results.series import diagnostics_in, dimensions_in, per_uav, span_where
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Obstacle, Scenario
from meanflock.swarm.wire.messages import Status

log = logging.getLogger("meanflock.plots")

Floats = NDArray[np.float64]

MAX_POINTS = 1500  # of a curve, or instants of a path
_MAX_SEGMENTS = 60_000  # of all paths
_MAX_PATHS = 2000  # UAVs whose paths are drawn, evenly chosen by number
_PANEL_IN = 4.5  # width of the paths in space
_SIDES = (0.4, 0.3), (1.1, 0.8)  # height of its panels from above and from the side, as shares of it: least and most


class RunPicture(NamedTuple):
    """A run for its pictures: its time series, its scenario, and its events as rows of events.jsonl."""

    table: pa.Table
    scenario: FlownKeys | Scenario
    events: Sequence[Mapping[str, Any]]


def stored(folder: Path, columns: list[str] | None = None) -> RunPicture:
    """The run in `folder`, with some columns of its time series, or all.

    Raises:
        BadInput: no run there, or one that never wrote a row.
    """
    return RunPicture(flown_rows(folder, columns), flown_keys(folder), _events(folder / EVENTS))


def plot_run(folder: Path) -> dict[str, Figure]:
    """`paths` and `curves` of the run in `folder`; raises as `stored`."""
    run = stored(folder)
    return {"paths": plot_paths(run), "curves": plot_curves(run)}


class UavPart(NamedTuple):
    """UAVs of one colour. name: of their group; empty without groups."""

    name: str
    rows: slice
    colour: str


def parts_of(flown: FlownKeys | Scenario) -> list[UavPart]:
    """The UAVs by group; without groups all in one."""
    if not flown.groups:
        return [UavPart("", slice(None), plotstyle.colour(flown.method))]
    return [
        UavPart(group.name, rows, plotstyle.group_colour(number))
        for number, (group, rows) in enumerate(mission.parts(flown))
    ]


# -- paths ---------------------------------------------------------------------------------------------------------


@plotstyle.style()
def plot_paths(run: RunPicture) -> Figure:
    """The paths of all UAVs on the map, with collisions, obstacles and goals; in space also from the side."""
    table, flown = run.table, run.scenario
    position = per_uav(table, *POSITION[: dimensions_in(table.schema)])
    figure, panels = _sides(position, flown)
    for ax, up in zip(panels, (1, 2), strict=False):
        _draw_paths(ax, run, position, up)
    end = _line(table, "sim_time_s")[-1]
    arrived = int(_line(table, "arrived")[-1])
    name, uavs = f"{mission.method(flown)}, seed {flown.seed}: " if flown.method else "", position.shape[1]
    some = f", {_MAX_PATHS} drawn" if uavs > _MAX_PATHS else ""
    plotstyle.titled(panels[0], "", f"{name}{arrived} of {uavs} arrived in {end:.0f} s{some}")
    marks = panels[0].get_legend_handles_labels()
    figure.legend(*marks, loc="outside lower center", ncols=5, handletextpad=0.2, columnspacing=1.2)
    if _is_shaded(run):
        label = plotstyle.tex(f"{FIELDS[PHI_G].name} as a UAV reports it ({FIELDS[PHI_G].unit})")
        figure.colorbar(ScalarMappable(**plotstyle.PHI_G), ax=panels, extend="both", label=label)
    return figure


def _sides(position: Floats, flown: FlownKeys | Scenario) -> tuple[Figure, Sequence[Axes]]:
    """An empty figure with a panel from above, and below it in space one from the side, with about the same scale."""
    if position.shape[-1] == state.PLANE:
        figure = plotstyle.figure(plotstyle.COLUMN_IN * 1.1, 3.9)
        return figure, [figure.subplots()]
    places = np.concatenate([position.reshape(-1, 3), mission.all_goals(flown), mission.stations(flown)])
    wide, deep, _ = np.maximum(np.ptp(places, axis=0), 1.0)
    shares = np.clip([deep / wide, places[:, 2].max() / wide], *_SIDES)
    figure = plotstyle.figure(plotstyle.COLUMN_IN * 1.1, 0.9 + _PANEL_IN * shares.sum())
    return figure, figure.subplots(2, 1, sharex=True, height_ratios=shares)


def _draw_paths(ax: Axes, run: RunPicture, position: Floats, up: int) -> None:
    """Draws paths, events and mission, from above (`up` is 1) or from the side (2); `position` is (T, N, axes)."""
    table, flown = run.table, run.scenario
    seen = position[..., [0, up]]
    ticks, uavs, _ = seen.shape
    shown = np.linspace(0, uavs - 1, min(uavs, _MAX_PATHS)).astype(np.intp)
    step = max(1, ticks // MAX_POINTS, ticks * len(shown) // _MAX_SEGMENTS)
    drawn = seen[:, shown]
    if _is_shaded(run):
        plotstyle.paths(ax, drawn[::step], _grid(table, PHI_G)[::step, shown])
    else:
        for part in parts_of(flown):
            own = np.isin(shown, np.arange(uavs)[part.rows])
            plotstyle.paths(ax, drawn[::step, own], part.colour)
            if part.name:
                ax.plot([], [], color=part.colour, label=part.name)
    ax.plot(*drawn[0].T, linestyle="", marker="s", markersize=2.0, color=plotstyle.PALE, label="start")
    ax.plot(*drawn[-1].T, linestyle="", marker="o", markersize=2.4, color=plotstyle.INK, label="end")
    collisions = places_of(run.events, "collision", seen)
    if up == 1 and (counted := int(_line(table, "collisions")[-1])) != len(collisions):
        log.warning("%s: %d of %d collisions; the others are not marked", EVENTS, len(collisions), counted)
    ax.plot(*collisions.T, **plotstyle.STAR, label=f"collisions: {int(_line(table, 'collisions')[-1])}")
    if len(flown.obstacles):
        hits = places_of(run.events, "hit", seen)
        ax.plot(*hits.T, **plotstyle.CROSS, label=f"obstacle hits: {len(hits)}")
    if position.shape[-1] == state.SPACE:
        grounded = places_of(run.events, "grounded", seen)
        ax.plot(*grounded.T, **plotstyle.FALLEN, label=f"grounded: {len(grounded)}")
    _draw_mission(ax, flown, up, float(position[..., -1].max()))
    ax.margins(0.05)
    if up == 1:
        ax.set_aspect("equal", adjustable="datalim" if position.shape[-1] == state.PLANE else "box")
        ax.set_ylabel("$y$ (m)")
    else:
        ax.axhline(0.0, color=plotstyle.INK, linewidth=0.7)  # the ground
        ax.set_ylabel("$z$ (m)")
    if up == position.shape[-1] - 1:
        ax.set_xlabel("$x$ (m)")


def _is_shaded(run: RunPicture) -> bool:
    """Returns whether paths are coloured by φ_G."""
    return PHI_G in diagnostics_in(run.table.schema) and not run.scenario.groups


def places_of(events: Iterable[Mapping[str, Any]], kind: str, position: Floats) -> Floats:
    """Mean positions of the UAVs at events of a kind, (K, 2), m; `position` is (T, N, 2)."""
    ticks, uavs, _ = position.shape
    places = [
        position[event["tick"], event["uavs"]].mean(axis=0)
        for event in events
        if event["kind"] == kind
        and event.get("uavs")
        and 0 <= event["tick"] < ticks
        and all(0 <= uav < uavs for uav in event["uavs"])
    ]
    return np.array(places).reshape(-1, 2)


def _events(path: Path) -> list[dict[str, Any]]:
    """Kind, tick and UAVs of the events in a file; lines that cannot be read are skipped, as the last after a kill."""
    found = []
    for text in stored_lines(path) if path.exists() else ():
        try:
            row = json.loads(text)
            uavs = [int(uav) for uav in row.get("uavs", ())]
            found.append({"kind": str(row["kind"]), "tick": int(row["tick"]), "uavs": uavs})
        except (ValueError, TypeError, KeyError, AttributeError):
            continue
    return found


def _draw_mission(ax: Axes, flown: FlownKeys | Scenario, up: int, highest: float) -> None:
    """Draws goals, obstacles, stations and landing places over the paths, and names them in the legend.

    Args:
        up: as for `_draw_paths`. highest: of all places of UAVs, m; a column without an end is drawn up to there.
    """
    goals, radius = mission.all_goals(flown), flown.destination.radius
    look = {"facecolor": plotstyle.PALE, "edgecolor": plotstyle.INK, "linewidth": 0.5, "zorder": 0.9}
    for obstacle in flown.obstacles:
        ax.add_patch(_outline(obstacle, up, highest, look))
    if len(flown.obstacles):
        ax.plot([], [], linestyle="", marker="o", color=plotstyle.PALE, label="obstacles")
    if len(flown.stations):
        places = mission.stations(flown)[:, [0, up]]
        ax.plot(*places.T, **plotstyle.TRIANGLE, label=f"station{'s' * (len(places) > 1)}")
    if len(places := mission.landings(flown)):
        ax.plot(*places[:, [0, up]].T, **plotstyle.SQUARE, label=f"landing place{'s' * (len(places) > 1)}")
    if (goals == goals[0]).all():
        for width, color in ((3.2, "white"), (1.6, plotstyle.GOAL)):  # above the paths that end in it
            size = {"fill": False, "edgecolor": color, "linewidth": width, "zorder": 5}
            ax.add_patch(Circle((goals[0, 0], goals[0, up]), radius, **size))
        ax.plot([], [], **plotstyle.RING, label=f"goal, {radius:g} m")
    else:
        marks = np.unique(goals[:, [0, up]], axis=0)
        ax.plot(*marks.T, linestyle="", marker="x", markersize=2.4, color=plotstyle.GOAL, zorder=5, label="goals")


def _outline(obstacle: Obstacle, up: int, highest: float, look: dict[str, Any]) -> Patch:
    """An obstacle from above or from the side: a circle or a polygon, or of a column from the side a rectangle."""
    if up == 1 and obstacle.polygon:
        return Polygon(obstacle.polygon, **look)
    if up == 1 or len(obstacle.centre) == state.SPACE:
        return Circle((obstacle.centre[0], obstacle.centre[up]), obstacle.radius, **look)
    top = obstacle.height
    x, _, radius = obstacle.disc
    low, high = x - radius, x + radius
    if obstacle.polygon:
        low, high = min(x for x, _ in obstacle.polygon), max(x for x, _ in obstacle.polygon)
    return Rectangle((low, 0.0), high - low, highest if top is None else top, **look)


# -- curves --------------------------------------------------------------------------------------------------------


@plotstyle.style()
def plot_curves(run: RunPicture) -> Figure:
    """A panel for every quantity of the time series."""
    parts = parts_of(run.scenario)
    panels = _Panels(run.table, run.scenario).all()
    rows = -(-len(panels) // 2)
    figure = plotstyle.figure(plotstyle.PAGE_IN, 1.9 * rows)
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False)
    for number, (panel, ax) in enumerate(zip(panels, axes.ravel(), strict=False)):
        panel.draw(ax)
        plotstyle.titled(ax, plotstyle.letter(number), panel.title)
        ax.set_ylabel(panel.label)
        ax.margins(x=0.0)
    if len(panels) < axes.size:
        axes[-1, -1].set_visible(False)
        axes[-2, -1].xaxis.set_tick_params(labelbottom=True)
        axes[-2, -1].set_xlabel(plotstyle.axis("t_s"))
    for ax in axes[-1]:
        ax.set_xlabel(plotstyle.axis("t_s"))
    if len(parts) > 1:
        handles = [Line2D([], [], color=part.colour, label=part.name) for part in parts]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(parts))
    return figure


def _grid(table: pa.Table, column: str) -> Floats:
    """A column of lists as (T, N)."""
    return per_uav(table, column)[..., 0].astype(np.float64)


def _line(table: pa.Table, column: str) -> Floats:
    """A column of numbers, (T,)."""
    return np.asarray(table.column(column).to_numpy(), dtype=np.float64)


class _Panel(NamedTuple):
    """A plot over time. label: of its y axis."""

    title: str
    label: str
    draw: Callable[[Axes], None]


class _Panels:
    """The panels of a time series."""

    def __init__(self, table: pa.Table, flown: FlownKeys | Scenario) -> None:
        self._table, self._parts = table, parts_of(flown)
        self._tone = self._parts[0].colour if len(self._parts) == 1 else plotstyle.INK  # of lines of the swarm
        self._joins = mission.joins(flown)
        self._step = max(1, table.num_rows // MAX_POINTS)
        self._times = _line(table, "sim_time_s")[:: self._step]
        self._uavs = len(table["x_m"][0])

    def all(self) -> list[_Panel]:
        """The panels of every flight, then those of the controller's reports."""
        axis, arrived = plotstyle.axis, FIELDS["arrived"].name
        axes = dimensions_in(self._table.schema)
        speed = reduce(np.hypot, (_grid(self._table, name) for name in VELOCITY[:axes]))
        panels = [
            _Panel(_ranged("energy_J"), axis("energy_J"), partial(self._span, _grid(self._table, "energy_J"))),
            _Panel(_ranged("speed_mean_m_s"), axis("speed_mean_m_s"), partial(self._span, speed)),
            _Panel(FIELDS["payload_bits.total"].name, axis("payload_bits.total"), self._bits),
            _Panel(FIELDS["phi_A"].remarked, axis("phi_A"), self._alignment),
            _Panel("collision risk φ_C", axis("phi_C"), self._risk),
            _Panel(f"{arrived} and collisions", "UAVs, pairs", self._arrived),
            *map(self._diagnostic, diagnostics_in(self._table.schema)),
        ]
        if axes == state.SPACE:
            height = partial(self._span, _grid(self._table, POSITION[-1]))
            panels.insert(2, _Panel("altitude: mean, max, min", "$z$ (m)", height))
        if self._table["weight_spread"].null_count < self._table.num_rows:
            panels.append(_Panel(FIELDS["weight_spread"].name, axis("weight_spread"), self._spread))
        return panels

    def _diagnostic(self, name: str) -> _Panel:
        measured, values = quantity(name), _grid(self._table, name)
        values[_grid(self._table, "status") >= Status.LOST] = np.nan  # a UAV that is lost or landed reports nothing
        values[_line(self._table, "tick")[:, None] <= self._joins] = np.nan  # nor does one before its first tick
        label = plotstyle.axis(name)
        if measured.logarithmic:
            return _Panel(f"{measured.name}, mean", label, partial(self._size, np.abs(values)))
        return _Panel(f"{measured.name}: mean, max, min", label, partial(self._span, values, from_zero=False))

    def _span(self, values: Floats, ax: Axes, from_zero: bool = True) -> None:
        rows = values[:: self._step]
        for part in self._parts:
            own = rows[:, part.rows]
            mean, low, high = span_where(own, np.isfinite(own)).T
            ax.fill_between(self._times, low, high, color=part.colour, alpha=0.18, linewidth=0)
            ax.plot(self._times, mean, color=part.colour)
        if from_zero:
            ax.set_ylim(bottom=0.0)
        elif not np.nan_to_num(rows).any():  # without this the axis would have ticks of ±0.04
            ax.set_ylim(0.0, 1.0)

    def _size(self, sizes: Floats, ax: Axes) -> None:
        rows = sizes[:: self._step]
        if np.nanmax(rows, initial=0.0) > 0:
            for part in self._parts:
                own = rows[:, part.rows]
                mean = span_where(own, np.isfinite(own))[:, 0]
                ax.plot(self._times, np.where(mean > 0, mean, np.nan), color=part.colour, linewidth=1.0)
            plotstyle.log_axis(ax)
        else:
            ax.annotate("the residual is zero", (0.5, 0.5), xycoords="axes fraction", ha="center")
            ax.set_yticks([])

    def _plot(self, ax: Axes, column: str, **look: Any) -> None:
        ax.plot(self._times, _line(self._table, column)[:: self._step], **{"color": self._tone, **look})

    def _bits(self, ax: Axes) -> None:
        bits = np.sum([_line(self._table, f"{name}_bits") for name in TRAFFIC.values()], axis=0)
        ax.plot(self._times, bits[:: self._step], color=self._tone)
        ax.set_ylim(bottom=0.0)
        plotstyle.bit_axis(ax.yaxis)

    def _alignment(self, ax: Axes) -> None:
        self._plot(ax, "phi_A")
        ax.set_ylim(bottom=0.0)

    def _risk(self, ax: Axes) -> None:
        self._plot(ax, "phi_C", label="with self-pairs")
        self._plot(ax, "phi_C_distinct", label="distinct pairs", linestyle="--")
        _legend(ax)

    def _arrived(self, ax: Axes) -> None:
        self._plot(ax, "arrived", label=f"arrived, of {self._uavs}")
        self._plot(
            ax,
            "collisions",
            label=f"collisions ({FIELDS['collisions'].unit})",
            color=plotstyle.STAR["color"],
            linewidth=1.0,
        )
        _legend(ax)

    def _spread(self, ax: Axes) -> None:
        spread = _line(self._table, "weight_spread")
        reported = np.isfinite(spread)
        ax.plot(_line(self._table, "sim_time_s")[reported], spread[reported], color=self._tone)
        ax.set_ylim(bottom=0.0)


def _ranged(field: str) -> str:
    return f"{FIELDS[field].name}: mean, max, min"


def _legend(ax: Axes) -> None:
    """Adds a legend with room above the lines."""
    ax.set_ylim(0.0, 1.3 * ax.dataLim.y1 if ax.dataLim.y1 > 0 else 1.0)
    ax.legend(loc="upper left", fontsize=7, ncols=2, borderaxespad=0.2)
