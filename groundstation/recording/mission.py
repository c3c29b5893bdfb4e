"""What the map of a recording shows of the mission: where it starts and ends, what is in the way, the wind."""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation.recording import palette
from meanflock.groundstation.recording.marks import Point, circle, label, line
from meanflock.groundstation.recording.part import Part
from meanflock.swarm import formations, mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.wind import MeanWind

ROOM = 0.22  # around a goal, as a share of the way there
BESIDE = 0.45  # of the mission's width, for the key to the map, where there is no room within
KEY = 0.36  # width of a key beside the map, as a share of the heights of all maps in a column
ARROWS = 14  # of the wind, along the longer side of the map
ARROW = 0.8  # length of the longest, as a share of their distance

Corners = tuple[NDArray[np.float64], NDArray[np.float64]]  # lower left and upper right, (2,) m


def is_about_its_start(scenario: Scenario) -> bool:
    """Whether the goals are where others start, as in a swap: no corner of the map is free then."""
    low, high = start_box(scenario)
    return _way_m(scenario) < 0.25 * float((high - low).max())


def box(scenario: Scenario) -> Corners:
    """What the map shows: all starts, all discs, all goals with room to overshoot, and a place for the key."""
    first, last = start_box(scenario)
    goals, discs = mission.goals(scenario), mission.obstacles(scenario)
    room = max(2 * scenario.destination.radius, ROOM * _way_m(scenario))
    low, high = np.minimum(first, goals.min(axis=0) - room), np.maximum(last, goals.max(axis=0) + room)
    for x, y, radius in discs.tolist():
        low, high = np.minimum(low, (x - radius, y - radius)), np.maximum(high, (x + radius, y + radius))
    if is_about_its_start(scenario):
        high = high + np.array([BESIDE * float(high[0] - low[0]), 0.0])
    return low, high


def key_box(scenario: Scenario, rows: int) -> Corners:
    """Left of what the map shows: the key of a map that is one of `rows` below each other, and so lower than wide."""
    low, high = box(scenario)
    width = KEY * rows * float(high[1] - low[1])
    return np.array([low[0] - width, low[1]]), np.array([low[0], high[1]])


def start_box(scenario: Scenario) -> Corners:
    """Around all starts, a spacing away from them."""
    places = mission.starts(scenario)[:, state.POSITION]
    return places.min(axis=0) - scenario.start.spacing, places.max(axis=0) + scenario.start.spacing


def log(stream: Part, scenario: Scenario, key: Corners) -> None:
    """Logs all of it, but no arrows where the key to the map is."""
    _log_wind(stream, scenario, key)
    _log_discs(stream, scenario)
    places, goals = mission.starts(scenario)[:, state.POSITION], mission.goals(scenario)
    low, high = start_box(scenario)
    if not scenario.start.positions and formations.of(scenario.start) in formations.GRIDS:
        corners = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
        line(stream, "map/start", corners, palette.GREY, 1.0)
    else:
        _dots(stream, "map/start", places, palette.GREY, 2.5)
    label(stream, "map/start/label", _below((low[0] + high[0]) / 2, low[1]), "start", palette.GREY)
    radius = scenario.destination.radius
    if (goals == goals[0]).all():
        line(stream, "map/goal", circle((goals[0, 0], goals[0, 1]), radius), palette.GREEN, 1.5)
        label(stream, "map/goal/label", _below(goals[0, 0], goals[0, 1] - radius), "goal", palette.GREEN)
    else:
        _dots(stream, "map/goal", goals, palette.GREEN, 1.2)
        edge = goals[:, 1].max() if is_about_its_start(scenario) else goals[:, 1].min()  # the other is the start's
        label(stream, "map/goal/label", _below(_middle(goals)[0], edge), "goals", palette.GREEN)


def _log_discs(stream: Part, scenario: Scenario) -> None:
    discs = mission.obstacles(scenario)
    if len(discs):
        filled = rr.Points2D(
            discs[:, :2], radii=discs[:, 2], colors=[palette.DISC], labels=_numbers(len(discs)), show_labels=False
        )
        stream.log("map/obstacles", filled)
        edges = [circle((x, y), radius) for x, y, radius in discs.tolist()]
        outline = rr.LineStrips2D(edges, colors=[palette.GREY], radii=rr.Radius.ui_points(1.0), draw_order=1.0)
        stream.log("map/obstacles/edges", outline)


def _log_wind(stream: Part, scenario: Scenario, key: Corners) -> None:
    """Arrows of the wind that the world flies, where it is not the same everywhere; the longest fills its place."""
    wind = MeanWind(scenario.flown())
    if wind.uniform:
        return
    low, high = box(scenario)
    step = float((high - low).max()) / ARROWS
    places = np.stack(np.meshgrid(*(np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))), axis=-1)
    places = places.reshape(-1, 2)
    places = places[~((places > key[0]) & (places < key[1])).all(axis=-1)]
    velocity = wind(np.concatenate([places, np.zeros_like(places)], axis=-1))
    vectors = velocity * (ARROW * step / np.sqrt(state.dot(velocity, velocity)).max())
    arrows = rr.Arrows2D(
        vectors=vectors,
        origins=places - vectors / 2,
        colors=[palette.BREEZE],
        radii=rr.Radius.ui_points(1.2),
        draw_order=-1.0,
    )
    stream.log("map/wind", arrows)


def _dots(stream: Part, entity: str, places: NDArray[np.float64], color: int, size: float) -> None:
    dots = rr.Points2D(places, colors=[color], radii=rr.Radius.ui_points(size), draw_order=1.0)
    stream.log(entity, dots)


def _way_m(scenario: Scenario) -> float:
    low, high = start_box(scenario)
    return math.hypot(*(_middle(mission.goals(scenario)) - (low + high) / 2))


def _middle(places: NDArray[np.float64]) -> NDArray[np.float64]:
    return (places.min(axis=0) + places.max(axis=0)) / 2


def _below(x: float, y: float) -> Point:
    return float(x), float(y)


def _numbers(count: int) -> Sequence[str]:
    return [f"obstacle {number}" for number in range(count)]
