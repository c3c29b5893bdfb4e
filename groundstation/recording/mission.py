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
MARGIN = 0.04  # around all that is shown, as a share of the longer side
KEY_PX = 260.0  # width of the map's key; its words are as long in every window
_WINDOW_PX = 1920.0  # width of the window for which the key is laid out
_SINGLE_PX = 960.0, 545.0  # size there of a flight's map beside its plots
_MAPS_PX, _TITLE_PX = 730.0, 30.0  # heights there of the maps of several flights together, and of the title of each
ARROWS = 14  # of the wind, along the longer side of the map
ARROW = 0.8  # length of the longest, as a share of their distance

Corners = tuple[NDArray[np.float64], NDArray[np.float64]]  # lower left and upper right, (2,) m


def is_about_its_start(scenario: Scenario) -> bool:
    """Whether the goals are where others start, as in a swap."""
    low, high = start_box(scenario)
    return _way_m(scenario) < 0.25 * float((high - low).max())


def box(scenario: Scenario) -> Corners:
    """What the map shows of the mission: all starts, all discs, all goals with room to overshoot."""
    first, last = start_box(scenario)
    goals, discs = mission.goals(scenario), mission.obstacles(scenario)
    room = max(2 * scenario.destination.radius, ROOM * _way_m(scenario))
    low, high = np.minimum(first, goals.min(axis=0) - room), np.maximum(last, goals.max(axis=0) + room)
    for x, y, radius in discs.tolist():
        low, high = np.minimum(low, (x - radius, y - radius)), np.maximum(high, (x + radius, y + radius))
    return low, high


def shape(maps: int) -> tuple[int, int]:
    """Rows and columns of so many maps."""
    columns = math.ceil(math.sqrt(maps))
    return math.ceil(maps / columns), columns


def key_box(scenario: Scenario, maps: int) -> Corners:
    """The place of the key, left of the mission, where it covers nothing. maps: in the same window."""
    low, high = box(scenario)
    wide, tall = (high - low) + 2 * MARGIN * float((high - low).max())
    rows, columns = shape(maps)
    view = (_WINDOW_PX / columns, _MAPS_PX / rows - _TITLE_PX) if maps > 1 else _SINGLE_PX
    metre_px = min((view[0] - KEY_PX) / wide, view[1] / tall)
    middle, half = (low[1] + high[1]) / 2, view[1] / metre_px / 2 / (1 + 2 * MARGIN)
    return np.array([low[0] - KEY_PX / metre_px, middle - half]), np.array([low[0], middle + half])


def start_box(scenario: Scenario) -> Corners:
    """Around all starts, a spacing away from them."""
    places = mission.starts(scenario)[:, state.POSITION]
    return places.min(axis=0) - scenario.start.spacing, places.max(axis=0) + scenario.start.spacing


def log(stream: Part, scenario: Scenario) -> None:
    """Logs all of it."""
    _log_wind(stream, scenario)
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


def _log_wind(stream: Part, scenario: Scenario) -> None:
    """Arrows of the wind that the world flies, where it is not the same everywhere; the longest fills its place."""
    wind = MeanWind(scenario.flown())
    if wind.uniform:
        return
    low, high = box(scenario)
    step = float((high - low).max()) / ARROWS
    places = np.stack(np.meshgrid(*(np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))), axis=-1)
    places = places.reshape(-1, 2)
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
