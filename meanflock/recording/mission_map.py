"""The fixed parts of the map of a recording: mission, wind, scale, and the key to its marks and colours.

The map is in metres with the goal at the origin and y up. The key stands left of the mission.
"""

import math
from typing import NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.recording import drawing
from meanflock.recording.drawing import Part, Point, circle
from meanflock.recording.routes import has_route, routes
from meanflock.results.series import Reported
from meanflock.swarm import mission, state
from meanflock.swarm.faults import Gust, Interference, Jam, Kill, Partition, Pause
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.base import MeanWind

ROOM = 0.22  # around a goal, as a share of the way there
MARGIN = 0.04  # around all that is shown, as a share of the longer side
KEY_PX = 260.0  # width of the key, enough for its words in every window
_WINDOW_PX = 1920.0  # width of the window for which the key is laid out
_SINGLE_PX = 960.0, 545.0  # size there of a flight's map beside its plots
_MAPS_PX, _TITLE_PX = 730.0, 30.0  # heights there of the maps of several flights together, and of the title of each
STATION = 0.02  # half the height of a station's triangle, as a share of the longer side of the map
ARROWS = 14  # of the wind, along the longer side of the map
ARROW = 0.8  # length of the longest arrow, as a share of their distance
_COLUMNS = 2  # of the key
_ROW = 1 / 12  # of the key's height, at most
_SAMPLE, _SCALE = 0.16, 0.7  # lengths of a sample, and at most of the scale's bar, in columns of the key

Corners = tuple[NDArray[np.float64], NDArray[np.float64]]  # lower left and upper right, (2,) m


class KeyLayout(NamedTuple):
    """The place of the key: middle of its upper left sample, width of a column, height of a row, length of a sample,
    all in m.
    """

    left: float
    top: float
    column: float
    row: float
    sample: float


# -- where things are ----------------------------------------------------------------------------------------------


def is_about_its_start(scenario: Scenario) -> bool:
    """Returns whether the goals are where other UAVs start, as in a swap."""
    low, high = start_box(scenario)
    return _way_m(scenario) < 0.25 * float((high - low).max())


def box(scenario: Scenario) -> Corners:
    """The mission on the map: all starts, all obstacles and stations, all goals with room to overshoot."""
    first, last = start_box(scenario)
    goals = state.flat(np.concatenate([mission.all_goals(scenario), mission.landings(scenario)]))
    discs = mission.obstacles(scenario)
    room = max(2 * scenario.destination.radius, ROOM * _way_m(scenario))
    low, high = np.minimum(first, goals.min(axis=0) - room), np.maximum(last, goals.max(axis=0) + room)
    for x, y, radius in discs.tolist():
        low, high = np.minimum(low, (x - radius, y - radius)), np.maximum(high, (x + radius, y + radius))
    if scenario.stations:
        places, room = mission.stations(scenario)[:, :2], 5.0 * STATION * float((high - low).max())  # of its name
        low, high = np.minimum(low, places.min(axis=0) - room), np.maximum(high, places.max(axis=0) + room)
    return low, high


def shape(maps: int) -> tuple[int, int]:
    """Rows and columns in which a window shows so many maps."""
    columns = math.ceil(math.sqrt(maps))
    return math.ceil(maps / columns), columns


def view_px(maps: int) -> tuple[float, float]:
    """Width and height of one of several `maps` in a window."""
    rows, columns = shape(maps)
    return (_WINDOW_PX / columns, _MAPS_PX / rows - _TITLE_PX) if maps > 1 else _SINGLE_PX


def round_length(most_m: float) -> float:
    """1, 2 or 5 times a power of ten, at most `most_m`."""
    power = 10.0 ** math.floor(math.log10(most_m))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most_m)


def key_box(scenario: Scenario, maps: int) -> Corners:
    """The place of the key, left of the mission, on one of several `maps` in a window."""
    low, high = box(scenario)
    wide, tall = (high - low) + 2 * MARGIN * float((high - low).max())
    view = view_px(maps)
    metre_px = min((view[0] - KEY_PX) / wide, view[1] / tall)
    middle, half = (low[1] + high[1]) / 2, view[1] / metre_px / 2 / (1 + 2 * MARGIN)
    return np.array([low[0] - KEY_PX / metre_px, middle - half]), np.array([low[0], middle + half])


def start_box(scenario: Scenario) -> Corners:
    """The box around all starts, with a margin of one spacing."""
    places = state.flat(mission.starts(scenario))
    return places.min(axis=0) - scenario.start.spacing, places.max(axis=0) + scenario.start.spacing


def layout(scenario: Scenario, words: int, maps: int = 1) -> KeyLayout:
    """The layout of a key of so many `words`, on one of several `maps`.

    The key begins level with the mission, or is centred where it is higher than the mission.
    """
    low, high = key_box(scenario, maps)
    column = float(high[0] - low[0]) / _COLUMNS
    lines = _rows_above(scenario) + math.ceil(words / _COLUMNS)
    row = float(high[1] - low[1]) * min(_ROW * shape(maps)[0], 1 / lines)
    mission_low, mission_high = box(scenario)
    top = max(float(mission_high[1]), float(mission_low[1] + mission_high[1] + lines * row) / 2)
    return KeyLayout(low[0] + column / 2, top - row / 2, column, row, _SAMPLE * column)


def _rows_above(scenario: Scenario) -> int:
    """Rows of the key above its samples: wind and scale, and without groups the colours of the trails."""
    return 1 if scenario.groups else 2


def _way_m(scenario: Scenario) -> float:
    low, high = start_box(scenario)
    return math.hypot(*(_middle(state.flat(mission.goals(scenario))) - (low + high) / 2))


def _below(places: NDArray[np.float64]) -> Point:
    return float(_middle(places)[0]), float(places[:, 1].min())


def _middle(places: NDArray[np.float64]) -> NDArray[np.float64]:
    return (places.min(axis=0) + places.max(axis=0)) / 2


# -- the mission ---------------------------------------------------------------------------------------------------


def log(part: Part, scenario: Scenario, reported: Reported, maps: int = 1) -> None:
    """Logs all fixed parts of one of several `maps`."""
    _log_field(part, scenario)
    _log_obstacles(part, scenario)
    _log_start(part, scenario)
    _log_routes(part, scenario)
    _log_goals(part, scenario)
    _log_stations(part, scenario)
    _log_key(part, scenario, reported, maps)


def _log_start(part: Part, scenario: Scenario) -> None:
    if scenario.groups:
        _log_starts_of_groups(part, scenario)
        return
    low, high = start_box(scenario)
    if not scenario.start.positions and mission.formation(scenario.start) in mission.GRIDS:
        corners = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
        part.line("map/start", corners, drawing.GREY, 1.0)
    else:
        part.dots("map/start", state.flat(mission.starts(scenario)), drawing.GREY, 2.5)
    part.label("map/start/label", (float(low[0] + high[0]) / 2, float(low[1])), "start", drawing.GREY)


def _log_starts_of_groups(part: Part, scenario: Scenario) -> None:
    """Logs a dot at each start, and a label below the starts of each group, and of those that share a formation."""
    starts = state.flat(mission.starts(scenario))
    sharing = np.ones(scenario.uavs, dtype=bool)
    for number, (group, rows) in enumerate(mission.parts(scenario)):
        if group.start is not None:
            sharing[rows] = False
            part.dots(f"map/start/groups/{group.name}", starts[rows], drawing.GREY, 2.0)
            part.label(f"map/start/label/{group.name}", _below(starts[rows]), group.name, drawing.group_color(number))
    if sharing.any():
        part.dots("map/start", starts[sharing], drawing.GREY, 2.0)
        part.label("map/start/label", _below(starts[sharing]), "start", drawing.GREY)


def _log_goals(part: Part, scenario: Scenario) -> None:
    goals, radius = state.flat(mission.goals(scenario)), scenario.destination.radius
    if scenario.groups:
        _log_goals_of_groups(part, scenario, goals)
        return
    if scenario.has_waypoints:
        return
    if (goals == goals[0]).all():
        x, y = goals[0].tolist()
        part.line("map/goal", circle((x, y), radius), drawing.GREEN, 1.5)
        part.label("map/goal/label", (x, y - radius), "goal", drawing.GREEN)
        return
    part.dots("map/goal", goals, drawing.GREEN, 1.2)
    edge = goals[:, 1].max() if is_about_its_start(scenario) else goals[:, 1].min()  # the other has the start's label
    part.label("map/goal/label", (float(_middle(goals)[0]), float(edge)), "goals", drawing.GREEN)


def _log_routes(part: Part, scenario: Scenario) -> None:
    """Logs a dot at each waypoint and each landing place, with a word below it."""
    for route in routes(scenario):
        entity, places = f"map/waypoints/{route.name or 'all'}", state.flat(route.places)
        part.dots(entity, places, route.color, 3.0)
        _log_words(part, f"{entity}/label", places, route.words, route.color)
    if len(places := state.flat(mission.landings(scenario))):
        part.dots("map/landings", places, drawing.GREY, 3.0)
        _log_words(part, "map/landings/label", places, ["landing"] * len(places), drawing.GREY)


def _log_words(part: Part, entity: str, places: NDArray[np.float64], words: list[str], color: int) -> None:
    """Logs those of the `words` that are not empty, each below its place (K, 2), m."""
    shown = [number for number, word in enumerate(words) if word]
    labels = rr.Points2D(
        places[shown], labels=[words[number] for number in shown], colors=[color], radii=0.0, show_labels=True
    )
    part.log(entity, labels)


def _log_goals_of_groups(part: Part, scenario: Scenario, goals: NDArray[np.float64]) -> None:
    """Logs the goal of each group without waypoints, once for groups that share it, or a dot in its colour at each goal
    of a UAV.
    """
    logged: set[tuple[float, float, float]] = set()
    guided = has_route(scenario)
    for number, (group, rows) in enumerate(mission.parts(scenario)):
        if guided[rows].all():
            continue
        places, radius = goals[rows], (group.destination or scenario.destination).radius
        x, y = places[0].tolist()
        if (places != places[0]).any():
            part.dots(f"map/goal/groups/{group.name}", places, drawing.group_color(number), 1.2)
        elif (x, y, radius) not in logged:
            logged.add((x, y, radius))
            part.line(f"map/goal/groups/{group.name}", circle((x, y), radius), drawing.GREEN, 1.5)
            part.label(f"map/goal/label/{group.name}", (x, y - radius), "goal", drawing.GREEN)


def _log_obstacles(part: Part, scenario: Scenario) -> None:
    discs = mission.obstacles(scenario)
    if not len(discs):
        return
    names = [f"obstacle {number}" for number in range(len(discs))]
    polygons = mission.polygons(scenario)
    radii = [0.0 if number in polygons else radius for number, radius in enumerate(discs[:, 2].tolist())]
    filled = rr.Points2D(discs[:, :2], radii=radii, colors=[drawing.DISC], labels=names, show_labels=False)
    part.log("map/obstacles", filled)
    edges = [
        polygons[number].ring if number in polygons else circle((x, y), radius)
        for number, (x, y, radius) in enumerate(discs.tolist())
    ]
    outline = rr.LineStrips2D(edges, colors=[drawing.GREY], radii=rr.Radius.ui_points(1.0), draw_order=1.0)
    part.log("map/obstacles/edges", outline)


def _log_stations(part: Part, scenario: Scenario) -> None:
    """Logs a triangle for each station, with its number and height."""
    size = STATION * float(np.subtract(*box(scenario)[::-1]).max())
    for number, (x, y, height) in enumerate(mission.stations(scenario).tolist()):
        part.line(f"map/stations/{number}", size * drawing.TRIANGLE + (x, y), drawing.STATION, 2.0)
        word = f"station {number}, {height:g} m up"
        part.label(f"map/stations/{number}/label", (x, y + 4.0 * size), word, drawing.STATION)  # above


def _log_field(part: Part, scenario: Scenario) -> None:
    """Logs arrows of a wind that depends on the place; the longest arrow fills its place."""
    wind = MeanWind(scenario.flown())
    if wind.uniform:
        return
    low, high = box(scenario)
    step = float((high - low).max()) / ARROWS
    places = np.stack(np.meshgrid(*(np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))), axis=-1)
    places = places.reshape(-1, 2)
    velocity = state.flat(wind(state.at_rest(mission.in_space(scenario, places)[:, : scenario.dimensions])))
    vectors = velocity * (ARROW * step / np.sqrt(state.dot(velocity, velocity)).max())
    arrows = rr.Arrows2D(
        vectors=vectors,
        origins=places - vectors / 2,
        colors=[drawing.BREEZE],
        radii=rr.Radius.ui_points(1.2),
        draw_order=-1.0,
    )
    part.log("map/wind", arrows)


# -- the key -------------------------------------------------------------------------------------------------------


def _log_key(part: Part, scenario: Scenario, reported: Reported, maps: int) -> None:
    samples = _samples(scenario)
    left, top, column, row, size = layout(scenario, len(samples), maps)
    _log_mean_wind(part, scenario, (left, top), 0.6 * row)
    _log_scale(part, (left + column, top), _SCALE * column)
    if not scenario.groups:
        _log_colours(part, left, left + column, top - row, 0.2 * size, reported.has_phi_g)
    above = _rows_above(scenario)
    for number, (word, color, outline, thickness) in enumerate(samples):
        at = left + number % _COLUMNS * column, top - (above + number // _COLUMNS) * row
        entity = f"map/legend/{'groups/' * (number < len(scenario.groups))}{word.replace(' ', '_')}"
        part.line(entity, outline * size / 2 + at, color, thickness)
        part.label(f"{entity}/word", (at[0], at[1] - 0.2 * size), word, color)


def _samples(scenario: Scenario) -> list[tuple[str, int, NDArray[np.float64], float]]:
    """The entries of the key: word, colour, a sample of size 1 and its thickness in points."""
    across, ring = np.array([(-1.0, 0.0), (1.0, 0.0)]), circle((0.0, 0.0), 0.5)
    samples = [
        *((group.name, drawing.group_color(number), across, 3.0) for number, group in enumerate(scenario.groups)),
        ("delivered", drawing.GREEN, across, 1.5),
        ("outage", drawing.RED, across, 1.5),
        ("collision", drawing.COLLISION, 0.7 * drawing.STAR, 1.2),
    ]
    if scenario.obstacles:
        samples.append(("obstacle", drawing.GREY, ring, 1.0))
        samples.append(("obstacle hit", drawing.HIT, 0.7 * drawing.CROSS, 1.5))
    if scenario.space.dimensions == state.SPACE:
        samples.append(("grounded", drawing.GROUNDED, -0.7 * drawing.TRIANGLE, 1.5))
    if any(group.joins_at_s or group.leaves_at_s is not None for group in scenario.groups):
        samples.append(("dark: on the ground", drawing.GREY, circle((0.0, 0.0), 0.3), 3.0))
    if scenario.federation.clusters > 1:
        samples.append(("head", drawing.HEAD, ring, 2.0))
    of_faults = {
        Pause: ("frozen", drawing.FROZEN, ring, 2.0),
        Partition: ("cut off", drawing.CUT, ring, 2.0),
        Jam: ("jammed", drawing.JAMMED, circle((0.0, 0.0), 0.8), 1.2),
        Interference: ("jammer", drawing.JAMMED, 0.7 * drawing.CROSS, 1.5),
        Gust: ("gust", drawing.GUST, across, 1.0),
        Kill: ("lost", drawing.GREY, ring, 2.0),
    }
    if scenario.stations:
        samples.append(("station", drawing.STATION, 0.7 * drawing.TRIANGLE, 2.0))
    kinds = {type(fault) for fault in scenario.faults}
    return samples + [sample for kind, sample in of_faults.items() if kind in kinds]


def _log_colours(part: Part, left: float, right: float, y: float, gap: float, by_phi_g: bool) -> None:
    """Logs a bar with the colours of φ_G, or of speed, and labels its ends."""
    if by_phi_g:
        entity = "map/legend/phi_G"
        low = f"φ_G ≤ {drawing.PHI_G_LOW:g}"
        high = f"≥ {drawing.PHI_G_HIGH:g} s⁻²"
    else:
        entity = "map/legend/speed"
        low = "speed 0"
        high = f"≥ {drawing.SPEED_HIGH:g} m/s"
    marks = np.linspace(left, right, 33)
    strips = np.stack([np.stack([marks[:-1], marks[1:]], axis=-1), np.full((32, 2), y)], axis=-1)  # (32, 2, 2)
    colors = drawing.viridis(np.linspace(0, 1, 32))
    part.log(entity, rr.LineStrips2D(strips.astype(np.float32), colors=colors, radii=rr.Radius.ui_points(3.0)))
    part.label(f"{entity}/low", (left, y - gap), low, drawing.GREY)
    part.label(f"{entity}/high", (right, y - gap), high, drawing.GREY)


def _log_mean_wind(part: Part, scenario: Scenario, at: Point, length: float) -> None:
    """Logs an arrow with the direction of the mean wind; the word has its speed."""
    wind = np.array(scenario.flown().wind.mean)
    speed = math.hypot(*wind)
    if speed:
        arrow = state.flat(wind) / speed * length
        tail = np.array([at[0], at[1] + length / 2]) - arrow / 2
        radii = rr.Radius.ui_points(1.5)
        arrows = rr.Arrows2D(vectors=[arrow], origins=[tail], colors=[drawing.GUST], radii=radii, draw_order=1.0)
        part.log("map/legend/wind", arrows)
    word = f"mean wind {speed:.2g} m/s" if speed else "no mean wind"
    part.label("map/legend/wind/word", at, word, drawing.GUST)


def _log_scale(part: Part, at: Point, most_m: float) -> None:
    """Logs a bar of a round length, at most `most_m` long."""
    length = round_length(most_m)
    ends = np.array([(-length / 2, 0.0), (length / 2, 0.0)])
    part.line("map/legend/scale", ends + at, drawing.WHITE, 1.5)
    part.label("map/legend/scale/word", at, f"{length:g} m", drawing.WHITE)
