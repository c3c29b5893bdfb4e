"""Plots of one run: its paths on the map, and its curves.

They need neither the controller nor the plug-ins of the run.
"""

import json
import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from numpy.typing import NDArray

from meanflock.results.event_log import stored_lines
from meanflock.results.flown import FlownKeys, flown_keys
from meanflock.results.plots import plotstyle
from meanflock.results.plots.curves import MAX_POINTS, plot_curves
from meanflock.results.plots.run_picture import RunPicture, parts_of
from meanflock.results.quantities import FIELDS, PHI_G, POSITION
from meanflock.results.run_folder import EVENTS, SCENARIO, check_uavs, flown_rows
from meanflock.results.series import diagnostics_in, dimensions_in, per_uav
from meanflock.results.timeseries_file import TIMESERIES
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Obstacle, Scenario
from meanflock.swarm.wire.messages import Status

log = logging.getLogger("meanflock.plots")

Floats = NDArray[np.float64]

_MAX_SEGMENTS = 60_000  # of all paths
_MAX_PATHS = 2000  # UAVs whose paths are drawn, evenly chosen by number
_PANEL_IN, _SHADED_IN = 4.5, 3.8  # width of the paths in space, and of those beside a colour bar
_SIDES = (0.4, 0.3), (1.1, 0.8)  # height of its panels from above and from the side, as shares of it: least and most


def stored(folder: Path, columns: list[str] | None = None) -> RunPicture:
    """The run in `folder`, with some columns of its time series, or all.

    Raises:
        BadInput: no run there, one that never wrote a row, or one of other UAVs than its scenario.
    """
    rows, flown = flown_rows(folder, columns), flown_keys(folder)
    if os.path.lexists(folder / SCENARIO):
        check_uavs(folder / TIMESERIES, rows, flown.uavs)
    else:
        flown = msgspec.structs.replace(flown, uavs=len(rows["x_m"][0]))
    return RunPicture(rows, flown, _events(folder / EVENTS))


def plot_run(folder: Path) -> dict[str, Figure]:
    """`paths` and `curves` of the run in `folder`; raises as `stored`."""
    run = stored(folder)
    return {"paths": plot_paths(run), "curves": plot_curves(run)}


@plotstyle.style()
def plot_paths(run: RunPicture) -> Figure:
    """The paths of all UAVs on the map, with collisions, obstacles and goals; in space also from the side."""
    table, flown = run.table, run.scenario
    position = per_uav(table, *POSITION[: dimensions_in(table.schema)])
    figure, panels = _sides(position, flown, _SHADED_IN if _is_shaded(run) else _PANEL_IN)
    for ax, up in zip(panels, (1, 2), strict=False):
        _draw_paths(ax, run, position, up)
    end = run.line("sim_time_s")[-1]
    arrived, lost = int(run.line("arrived")[-1]), int(np.count_nonzero(run.grid("status")[-1] == Status.LOST))
    name, uavs = f"{mission.method(flown)}, seed {flown.seed}: " if flown.method else "", position.shape[1]
    others = f", {lost} lost" if lost else ""
    others += f", {_MAX_PATHS} drawn" if uavs > _MAX_PATHS else ""
    if any(event["kind"] == "uncommanded" for event in run.events):
        others += f"\n{'some' if flown.groups else 'the'} UAVs replay recorded movement: commands have no effect"
    plotstyle.titled(panels[0], "", f"{name}{arrived} of {uavs} arrived in {end:g} s{others}")
    named = [line for line in panels[0].get_lines() if not str(line.get_label()).startswith("_")]
    plotstyle.place_legend(figure, named, "outside lower center")
    if _is_shaded(run):
        label = plotstyle.tex(f"{FIELDS[PHI_G].name} as a UAV reports it ({FIELDS[PHI_G].unit})")
        shrink = 1.0 / len(panels)
        figure.colorbar(ScalarMappable(**plotstyle.PHI_G), ax=panels, extend="both", label=label, shrink=shrink)
    return figure


def _sides(position: Floats, flown: FlownKeys | Scenario, width_in: float) -> tuple[Figure, Sequence[Axes]]:
    """An empty figure with a panel from above, and below it in space one from the side, with about the same scale.

    `width_in`: of the panels in space.
    """
    if position.shape[-1] == state.PLANE:
        figure = plotstyle.figure(plotstyle.COLUMN_IN * 1.1, 3.9)
        return figure, [figure.subplots()]
    places = np.concatenate([position.reshape(-1, 3), mission.all_goals(flown), mission.stations(flown)])
    wide, deep, _ = np.maximum(np.ptp(places, axis=0), 1.0)
    shares = np.clip([deep / wide, places[:, 2].max() / wide], *_SIDES)
    figure = plotstyle.figure(plotstyle.COLUMN_IN * 1.1, 1.25 + width_in * shares.sum())
    return figure, figure.subplots(2, 1, sharex=True, height_ratios=shares)


def _draw_paths(ax: Axes, run: RunPicture, position: Floats, up: int) -> None:
    """Draws paths, events and mission, from above (`up` is 1) or from the side (2); `position` is (T, N, axes)."""
    flown = run.scenario
    seen = position[..., [0, up]]
    ticks, uavs, _ = seen.shape
    shown = np.linspace(0, uavs - 1, min(uavs, _MAX_PATHS)).astype(np.intp)
    step = max(1, ticks // MAX_POINTS, ticks * len(shown) // _MAX_SEGMENTS)
    drawn = seen[:, shown]
    if _is_shaded(run):
        plotstyle.paths(ax, drawn[::step], run.grid(PHI_G)[::step, shown])
    else:
        for part in parts_of(flown):
            own = np.isin(shown, np.arange(uavs)[part.rows])
            plotstyle.paths(ax, drawn[::step, own], part.colour, dash=part.dash)
            if part.name:
                ax.plot([], [], color=part.colour, linestyle=part.dash, label=part.name)
    ax.plot(*drawn[0].T, linestyle="", marker="s", markersize=2.0, color=plotstyle.PALE, label="start", zorder=0.95)
    ax.plot(*drawn[-1].T, linestyle="", marker="o", markersize=1.8, color=plotstyle.INK, label="end")
    collisions = places_of(run.events, "collision", seen)
    if up == 1 and (counted := int(run.line("collisions")[-1])) != len(collisions):
        log.warning("%s: %d of %d collisions; the others are not marked", EVENTS, len(collisions), counted)
    ax.plot(*collisions.T, **plotstyle.STAR, label=f"collisions: {int(run.line('collisions')[-1])}")
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
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            continue
    return found


def _draw_mission(ax: Axes, flown: FlownKeys | Scenario, up: int, highest: float) -> None:
    """Draws obstacles, stations, landing places and goals, and names them in the legend.

    Args:
        up: as for `_draw_paths`. highest: of all places of UAVs, m; a column without an end is drawn up to there.
    """
    look = {"facecolor": plotstyle.PALE, "edgecolor": plotstyle.INK, "linewidth": 0.5, "zorder": 0.9}
    for obstacle in flown.obstacles:
        ax.add_patch(_outline(obstacle, up, highest, look))
    if len(flown.obstacles):
        marker = plotstyle.obstacle_marker(flown.obstacles)
        ax.plot([], [], **plotstyle.OBSTACLE, marker=marker, label="obstacles")
    if len(flown.stations):
        places = mission.stations(flown)[:, [0, up]]
        ax.plot(*places.T, **plotstyle.TRIANGLE, label=f"station{'s' * (len(places) > 1)}")
    if len(places := mission.landings(flown)):
        ax.plot(*places[:, [0, up]].T, **plotstyle.SQUARE, label=f"landing place{'s' * (len(places) > 1)}")
    _draw_goals(ax, flown, up)


def _draw_goals(ax: Axes, flown: FlownKeys | Scenario, up: int) -> None:
    """Draws the waypoints of a group as crosses, else its goal as a disc, or its goals as crosses.

    The paths that end in a disc are above it, and only its edge is above them. `up`: as for `_draw_paths`.
    """
    goals = mission.goals(flown)
    places: dict[str, Floats] = {}
    discs: dict[str, set[tuple[float, float, float]]] = {}
    for rows, destination in mission.destinations(flown):
        own = goals[rows]
        if destination.waypoints:
            own = np.array(flown.space.vectors(destination.waypoints, flown.start.height))
        elif (own == own[0]).all():
            discs.setdefault(f"goal, {destination.radius:g} m", set()).add((own[0, 0], own[0, up], destination.radius))
            continue
        label = "waypoints" if destination.waypoints else "goals"
        places[label] = np.concatenate([places.get(label, own[:0]), own])
    for label, rings in discs.items():
        for x, y, radius in sorted(rings):
            ax.add_patch(Circle((x, y), radius, facecolor=f"{plotstyle.GOAL}30", zorder=0.95))
            for width, color in ((2.2, "white"), (1.2, plotstyle.GOAL)):
                ax.add_patch(Circle((x, y), radius, fill=False, edgecolor=color, linewidth=width, zorder=5))
        ax.plot([], [], **plotstyle.RING, label=label)
    for label, marks in places.items():
        marker = "+" if label == "waypoints" else "x"
        x, y = np.unique(marks[:, [0, up]], axis=0).T
        ax.plot(x, y, linestyle="", marker=marker, markersize=3.4, color=plotstyle.GOAL, label=label)


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
