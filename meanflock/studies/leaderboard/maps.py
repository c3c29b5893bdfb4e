"""A small map of a mission: starts, ways, goals, obstacles and wind."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from meanflock.results.plots import plotstyle
from meanflock.studies.leaderboard.board import Course
from meanflock.studies.leaderboard.missions import BoardMission
from meanflock.swarm import mission, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Gust
from meanflock.swarm.scenario import Scenario, validated
from meanflock.worldsim.vehicles.base import MeanWind

_SIDE_IN = 2.5
_WIND, _GUST, _DISC = "#0072B2", "#D55E00", "#8A8A8A"
_ROOM = 0.1  # around everything, as a share of the longer side
_ARROW = 0.16  # length of the arrow of the mean wind, as a share of the longer side
_CORNER = np.array([0.4, -0.4])  # its place, from the middle in shares of the side
_FIELD = 9  # arrows of a wind that varies from place to place, along a side
_SMALL_PT = 6.5
_RING: dict[str, Any] = {**plotstyle.RING, "markersize": 3.6, "markeredgewidth": 0.8}


def draw(flown: Scenario) -> Figure:
    """The map of a scenario, in metres."""
    starts, goals = state.flat(mission.starts(flown)), state.flat(mission.goals(flown))
    discs, marks = mission.obstacles(flown), state.flat(mission.all_goals(flown))
    with plotstyle.style():
        figure = plotstyle.figure(_SIDE_IN, _SIDE_IN)
        ax = figure.subplots()
        edge = flown.destination.radius
        corners = np.concatenate(
            [starts, marks - edge, marks + edge, discs[:, :2] - discs[:, 2:], discs[:, :2] + discs[:, 2:]]
        )
        low, high = corners.min(axis=0), corners.max(axis=0)
        side = float((high - low).max()) * (1.0 + 2.0 * _ROOM)
        middle = (low + high) / 2.0
        ax.set(xlim=(middle[0] - side / 2, middle[0] + side / 2), ylim=(middle[1] - side / 2, middle[1] + side / 2))
        ax.set_aspect("equal")
        _wind(ax, flown, middle, side)
        ways = LineCollection(list(np.stack([starts, goals], axis=1)), colors=plotstyle.PALE, linewidths=0.4, alpha=0.5)
        ax.add_collection(ways)
        polygons = mission.polygons(flown)
        round_ = np.delete(discs, list(polygons), axis=0)
        _circles(ax, round_[:, :2], round_[:, 2], _DISC, filled=True)
        for polygon in polygons.values():
            ax.add_patch(Polygon(polygon.corners, facecolor=_DISC, edgecolor="none"))
        places = np.unique(marks, axis=0)
        if len(places) == 1:
            _circles(ax, places, np.full(1, edge), plotstyle.GOAL, filled=False)
        else:
            ax.plot(*places.T, **_RING)
        ax.plot(*starts.T, linestyle="", marker="o", markersize=1.7, color=plotstyle.INK)
        _gusts(ax, flown, starts, side)
        ax.tick_params(labelsize=_SMALL_PT)
        ax.set_xlabel("x (m)", fontsize=_SMALL_PT, labelpad=1.0)
        ax.set_ylabel("y (m)", fontsize=_SMALL_PT, labelpad=1.0)
        _legend(figure, flown)
    return figure


def write(courses: Sequence[Course], out: Path) -> dict[str, Path]:
    """Writes `out`/MISSION-map.png and .svg; the PNG of each mission whose file is here.

    Raises:
        OSError: it cannot be written.
    """
    drawn = {}
    for course in courses:
        try:
            flown = validated({**BoardMission(course.name).table(), "uavs": course.uavs}, Scenario, course.name)
        except BadInput:  # the reader's own mission, on another machine
            continue
        drawn[course.name] = plotstyle.save(draw(flown), out, f"{Path(course.name).stem}-map")[0]
    return drawn


def _circles(ax: Axes, places: state.Vectors, radii: state.Floats, colour: str, *, filled: bool) -> None:
    size = 2.0 * radii
    look = {"facecolors": colour, "alpha": 0.75} if filled else {"facecolors": "none", "edgecolors": colour}
    ax.add_collection(
        EllipseCollection(size, size, np.zeros(len(size)), units="xy", offsets=places, transOffset=ax.transData, **look)
    )


def _wind(ax: Axes, flown: Scenario, middle: state.Floats, side: float) -> None:
    """The true wind: an arrow in the corner if it is the same everywhere, else arrows all over the map."""
    wind = MeanWind(flown.flown())
    if wind.uniform:
        if speed := _speed(flown):
            length = np.array(flown.flown().wind.mean[:2]) / speed * _ARROW * side
            _arrows(ax, (middle + side * _CORNER - length / 2.0)[None], length[None], _WIND)
        return
    along = (np.arange(_FIELD) + 0.5) / _FIELD - 0.5
    places = middle + side * np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    velocity = state.flat(wind(state.at_rest(mission.in_space(flown, places)[:, : flown.dimensions])))
    vectors = velocity * (0.85 * side / _FIELD / np.hypot(*velocity.T).max())
    _arrows(ax, places - vectors / 2.0, vectors, _WIND, width=0.008, alpha=0.6)


def _speed(flown: Scenario) -> float:
    return math.hypot(*flown.flown().wind.mean[:2])


def _gusts(ax: Axes, flown: Scenario, starts: state.Vectors, side: float) -> None:
    """The accelerations of gusts, from the middle of the starts."""
    if gusts := _pushes(flown):
        pushes = np.array(gusts)
        lengths = pushes / np.hypot(*pushes.T).max() * 0.75 * _ARROW * side
        _arrows(ax, np.repeat(starts.mean(axis=0)[None], len(gusts), axis=0), lengths, _GUST, width=0.009)


def _pushes(flown: Scenario) -> list[tuple[float, ...]]:
    return [fault.acceleration[:2] for fault in flown.faults if isinstance(fault, Gust)]


def _arrows(
    ax: Axes, tails: state.Vectors, vectors: state.Vectors, colour: str, width: float = 0.014, alpha: float = 1.0
) -> None:
    ax.quiver(*tails.T, *vectors.T, angles="xy", scale_units="xy", scale=1.0, color=colour, width=width, alpha=alpha)


def _legend(figure: Figure, flown: Scenario) -> None:
    uniform, speed = not flown.flown().wind.field_rms, _speed(flown)
    lines: list[tuple[str, dict[str, Any]]] = [
        ("start", {"linestyle": "", "marker": "o", "markersize": 2.5, "color": plotstyle.INK}),
        ("waypoint" if any(each.waypoints for _, each in mission.destinations(flown)) else "goal", _RING),
    ]
    if flown.obstacles:
        marker = plotstyle.obstacle_marker(flown.obstacles)
        lines.append(("obstacle", {"linestyle": "", "marker": marker, "markersize": 4.5, "color": _DISC}))
    if speed or not uniform:
        wind = f"wind {speed:.2g} m/s" if uniform else "wind of one seed"
        lines.append((wind, {"color": _WIND, "linewidth": 1.6}))
    if _pushes(flown):
        lines.append(("gusts", {"color": _GUST, "linewidth": 1.6}))
    figure.legend(
        handles=[Line2D([], [], label=label, **look) for label, look in lines],
        loc="outside upper center",
        ncols=len(lines),
        fontsize=_SMALL_PT,
        handlelength=1.2,
        handletextpad=0.4,
        columnspacing=0.8,
        borderpad=0.0,
    )
