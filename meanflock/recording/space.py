"""The view in space of a recording: ground, heights and mission, the look of what moves, and the camera.

It is in metres as the scenario, z up. A view in space has no place for a key; the map has it.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from meanflock.recording import drawing
from meanflock.recording.branches import IN_SPACE, MARKS
from meanflock.recording.drawing import Floats, Part, Sent, Ticks, circle, cut
from meanflock.recording.routes import has_route, routes
from meanflock.recording.stage import Stage, Vectors
from meanflock.results.groups import uav_names
from meanflock.swarm import mission, state
from meanflock.swarm.polygons import Polygon
from meanflock.swarm.scenario import Scenario

ROOT = IN_SPACE.root
DROPS = f"{ROOT}/drops"  # from each UAV down to the ground
GROUND, HEIGHTS = f"{ROOT}/ground", f"{ROOT}/heights"
COLUMNS, SPHERES, PRISMS = (f"{ROOT}/obstacles/{name}" for name in ("columns", "spheres", "prisms"))

_RING, _TICK = 0.012, 0.01  # radius of the leader's ring, and half a tick of the scale, as shares of the stage's size
_GRID, _DIM = 0x2A303CFF, 0x5A6274FF


# -- the fixed parts -----------------------------------------------------------------------------------------------


def log(part: Part, scenario: Scenario, maps: int = 1) -> None:
    """Logs what does not move, and the look of what moves, for one of several `maps`."""
    stage = Stage(scenario, maps)
    part.log(ROOT, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    _log_looks(part, scenario)
    if scenario.federation.station is None:
        ring = circle((0.0, 0.0), _RING * stage.size)
        _lines(part, f"{IN_SPACE.leader}/ring", [state.in_three(ring)], drawing.WHITE, 1.2)
    _log_ground(part, stage)
    _log_heights(part, stage)
    _log_mission(part, scenario)
    _log_obstacles(part, scenario, stage)


def _log_looks(part: Part, scenario: Scenario) -> None:
    size = rr.Radius.ui_points
    names = uav_names(scenario)  # shown under the mouse
    part.log(IN_SPACE.uavs, rr.Points3D.from_fields(radii=size(4.5), labels=names, show_labels=False))
    part.log(IN_SPACE.velocity, rr.Arrows3D.from_fields(colors=[drawing.WHITE], radii=size(0.8)))
    part.log(IN_SPACE.trails, rr.LineStrips3D.from_fields(radii=size(1.0)))
    part.log(IN_SPACE.model_links, rr.LineStrips3D.from_fields(radii=size(1.0)))
    part.log(DROPS, rr.LineStrips3D.from_fields(colors=[_DIM], radii=size(0.4)))
    for kind, mark in MARKS.items():
        look = rr.LineStrips3D.from_fields(colors=[mark.color], radii=size(mark.thickness))
        part.log(IN_SPACE.marks[kind], look)


def _lines(part: Part, entity: str, lines: Sequence[Vectors], color: int, thickness: float) -> None:
    part.log(entity, rr.LineStrips3D(lines, colors=[color], radii=rr.Radius.ui_points(thickness)))


def _dots(part: Part, entity: str, places: Vectors, color: int) -> None:
    part.log(entity, rr.Points3D(places, colors=[color], radii=rr.Radius.ui_points(2.0)))


def _labels(part: Part, entity: str, places: Vectors, words: list[str], color: int) -> None:
    """Logs those of the `words` that are not empty, each at its place."""
    shown = [number for number, word in enumerate(words) if word]
    labels = [words[number] for number in shown]
    part.log(entity, rr.Points3D(places[shown], labels=labels, colors=[color], radii=0.0, show_labels=True))


def _log_ground(part: Part, stage: Stage) -> None:
    """Logs a grid at z = 0, and the side of its cells."""
    (left, front), (right, back), cell = stage.low, stage.high, stage.cell
    lines = [np.array([(x, front, 0.0), (x, back, 0.0)]) for x in np.arange(left, right + cell / 2, cell)]
    lines += [np.array([(left, y, 0.0), (right, y, 0.0)]) for y in np.arange(front, back + cell / 2, cell)]
    _lines(part, GROUND, lines, _GRID, 0.6)
    _lines(part, f"{GROUND}/bar", [stage.bar], drawing.WHITE, 1.5)
    _labels(part, f"{GROUND}/bar/word", stage.bar.mean(axis=0, keepdims=True), [f"{cell:g} m"], drawing.WHITE)


def _log_heights(part: Part, stage: Stage) -> None:
    """Logs a scale of heights with their numbers, beside the ground."""
    tick = _TICK * stage.size * stage.camera.right
    ticks = [np.stack([place - tick, place + tick]) for place in stage.scale]
    _lines(part, HEIGHTS, [stage.scale[[0, -1]], *ticks], drawing.GREY, 1.0)
    words = [f"{height:g} m" for height in stage.heights.tolist()]
    _labels(part, f"{HEIGHTS}/words", stage.scale - 4.0 * tick, words, drawing.GREY)


def _log_mission(part: Part, scenario: Scenario) -> None:
    """Logs starts, goals, waypoints, landing places and stations at their heights."""
    starts = state.position(mission.starts(scenario))
    goals = np.unique(mission.goals(scenario)[~has_route(scenario)], axis=0)
    radius = scenario.destination.radius
    _dots(part, f"{ROOT}/start", starts, drawing.GREY)
    for number, (group, own) in enumerate(mission.parts(scenario)):
        if group.start is not None:
            above = [*starts[own, :2].mean(axis=0), starts[own, 2].max()]
            color = drawing.group_color(number)
            _labels(part, f"{ROOT}/start/{group.name}", np.array([above]), [group.name], color)
    if len(goals) == 1:
        sphere = rr.Ellipsoids3D(
            centers=goals,
            half_sizes=[[radius] * 3],
            colors=[drawing.GREEN],
            line_radii=rr.Radius.ui_points(0.6),
            fill_mode="majorwireframe",
        )
        part.log(f"{ROOT}/goal", sphere)
        _labels(part, f"{ROOT}/goal/label", np.add(goals, (0.0, 0.0, radius)), ["goal"], drawing.GREEN)
    elif len(goals):
        _dots(part, f"{ROOT}/goal", goals, drawing.GREEN)
    for route in routes(scenario):
        entity = f"{ROOT}/waypoints/{route.name or 'all'}"
        _dots(part, entity, route.places, route.color)
        _labels(part, f"{entity}/label", route.places, route.words, route.color)
    if len(places := mission.landings(scenario)):
        _dots(part, f"{ROOT}/landings", places, drawing.GREY)
        _labels(part, f"{ROOT}/landings/label", places, ["landing"] * len(places), drawing.GREY)
    stations = mission.stations(scenario)
    if len(stations):
        masts = [np.array([(x, y, 0.0), (x, y, height)]) for x, y, height in stations.tolist()]
        _lines(part, f"{ROOT}/stations", masts, drawing.STATION, 2.0)
        _labels(part, f"{ROOT}/stations/label", stations, _names("station", len(stations)), drawing.STATION)


def _log_obstacles(part: Part, scenario: Scenario, stage: Stage) -> None:
    """Logs columns, spheres, and the edges of polygons."""
    shown = [(obstacle, *stage.extent(obstacle)) for obstacle in scenario.obstacles]
    columns = [each for each in shown if len(each[0].centre) == state.PLANE]
    spheres = [each for each in shown if len(each[0].centre) == state.SPACE]
    if columns:
        part.log(
            COLUMNS,
            rr.Cylinders3D(
                lengths=[high - low for _, low, high in columns],
                radii=[obstacle.radius for obstacle, _, _ in columns],
                centers=[(*obstacle.centre, (low + high) / 2) for obstacle, low, high in columns],
                colors=[_DIM],
                fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
            ),
        )
    if spheres:
        part.log(
            SPHERES,
            rr.Ellipsoids3D(
                centers=[obstacle.centre for obstacle, _, _ in spheres],
                half_sizes=[[obstacle.radius] * 3 for obstacle, _, _ in spheres],
                colors=[_DIM],
                fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
            ),
        )
    prisms = [(each.outline, low, high) for each, low, high in shown if each.outline is not None]
    if prisms:
        _lines(part, PRISMS, [line for each in prisms for line in _edges(*each)], _DIM, 1.0)


def _edges(polygon: Polygon, low: float, high: float) -> list[Vectors]:
    """Edges of a prism: below, above, and a line up at each corner."""
    rings = [state.in_three(polygon.ring) + np.array([0.0, 0.0, height]) for height in (low, high)]
    return [*rings, *(np.array([(x, y, low), (x, y, high)]) for x, y in polygon.corners.tolist())]


def _names(kind: str, count: int) -> list[str]:
    return [f"{kind} {number}" for number in range(count)]


# -- what moves ----------------------------------------------------------------------------------------------------


def rows(ticks: Ticks, positions: Floats) -> Iterator[Sent]:
    """A line down to the ground from each UAV at `positions` (R, N, 3), m, at ticks (R,).

    The axes of a vehicle that has an attitude belong here, too.
    """
    lines = np.repeat(positions.reshape(-1, 1, 3), 2, axis=1)
    lines[:, 1, 2] = 0.0
    yield DROPS, ticks, cut(len(ticks), (IN_SPACE.strips, IN_SPACE.lines(lines)))


# -- the camera ----------------------------------------------------------------------------------------------------


def eye(scenario: Scenario, maps: int) -> rrb.EyeControls3D:
    """The camera of one of several views in a window; it turns about the middle of the mission."""
    camera = Stage(scenario, maps).camera
    return rrb.EyeControls3D(position=camera.place, look_target=camera.target, eye_up=(0.0, 0.0, 1.0))
