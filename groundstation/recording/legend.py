"""What of the map stays where it is: the mission, wind, scale, and a key to the colours."""

import math
from typing import NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import mission as recording_mission
from meanflock.groundstation.recording import palette
from meanflock.groundstation.recording.marks import Point, circle, label, line
from meanflock.groundstation.recording.part import Part
from meanflock.groundstation.reported import Reported
from meanflock.swarm import mission, state
from meanflock.swarm.faults import Gust, Jam, Kill, Partition, Pause
from meanflock.swarm.scenario import Scenario

_COLUMNS, _COLUMN, _ROW = 4, 0.095, 0.085  # of the key, steps as shares of the map's width
_LOW_ROW = 0.0625  # a row of a key beside the map, as a share of the heights of all maps in a column
_SAMPLE = 0.035  # length of a sample, likewise
_SCALE = 0.16  # of the bar that shows the scale, at the most
_CORNERS = np.arange(11) * (math.pi / 5) + math.pi / 2
STAR = np.stack([np.cos(_CORNERS), np.sin(_CORNERS)], axis=-1) * np.where(np.arange(11) % 2, 0.4, 1.0)[:, None]


class Layout(NamedTuple):
    """Where the key stands: left and top, its columns and rows, the length of a sample and of the scale at most, m.

    area: the corners of all of it.
    """

    left: float
    top: float
    columns: int
    column: float
    row: float
    sample: float
    scale: float
    area: recording_mission.Corners


def layout(scenario: Scenario, words: int, rows: int = 1) -> Layout:
    """The place for a key of so many `words`: in a free corner of the map or, of several `rows` of maps, beside it."""
    if rows > 1:
        low, high = recording_mission.key_box(scenario, rows)
        column, row = float(high[0] - low[0]) / 2, _LOW_ROW * rows * float(high[1] - low[1])
        return Layout(low[0] + column / 2, high[1] - row / 2, 2, column, row, 0.16 * column, 0.7 * column, (low, high))
    low, high = recording_mission.box(scenario)
    width = float(high[0] - low[0])
    x, y = mission.starts(scenario)[:, state.POSITION].mean(axis=0)
    # The way leads from the start to the goal, so the corner beside the start is free; else there is room on the right.
    column, row = _COLUMN * width, _ROW * width
    lines = 2 + math.ceil(words / _COLUMNS)
    on_the_right = x < 0 or recording_mission.is_about_its_start(scenario)
    left = float(high[0] - (_COLUMNS - 0.5) * column if on_the_right else low[0] + column / 2)
    top = float(high[1] - row / 2 if y >= 0 else low[1] + lines * row)
    area = np.array([left - column / 2, top - lines * row]), np.array([left + (_COLUMNS - 0.5) * column, top + row])
    return Layout(left, top, _COLUMNS, column, row, _SAMPLE * width, _SCALE * width, area)


def log(stream: Part, scenario: Scenario, reported: Reported, rows: int = 1) -> None:
    """Logs the map's fixed parts, and those of the close-up on the leader; `rows`: of maps below each other."""
    key = _key(scenario)
    where = layout(scenario, len(key), rows)
    left, top, column, row = where.left, where.top, where.column, where.row
    recording_mission.log(stream, scenario, where.area)
    quarter = (where.columns - 2) * column / 4  # wind and scale in the middle of either half
    _log_wind(stream, scenario, (left + quarter, top), 0.6 * row)
    _log_scale(stream, "map/legend/scale", (left + (where.columns / 2) * column + quarter, top), where.scale)
    _log_colours(stream, left, left + (where.columns - 1) * column, top - row, 0.2 * where.sample, reported.has_phi_g)
    for number, (word, color, shape, thickness) in enumerate(key):
        at = left + number % where.columns * column, top - (2 + number // where.columns) * row
        entity = f"map/legend/{word.replace(' ', '_')}"
        line(stream, entity, shape * where.sample / 2 + at, color, thickness)
        label(stream, f"{entity}/word", (at[0], at[1] - 0.2 * where.sample), word, color)
    _log_close_up(stream, scenario)


def _key(scenario: Scenario) -> list[tuple[str, int, NDArray[np.float64], float]]:
    """What is drawn in which colour: word, colour, a sample of size 1 and how thick it is, in points."""
    across, ring = np.array([(-1.0, 0.0), (1.0, 0.0)]), circle((0.0, 0.0), 0.5)
    key = [
        ("delivered", palette.GREEN, across, 1.5),
        ("outage", palette.RED, across, 1.5),
        ("collision", palette.COLLISION, 0.7 * STAR, 1.2),
    ]
    if scenario.obstacles:
        key.append(("obstacle", palette.GREY, ring, 1.0))
    if scenario.federation.clusters > 1:
        key.append(("head", palette.HEAD, ring, 2.0))
    kinds = {type(fault) for fault in scenario.faults}
    if Pause in kinds:
        key.append(("frozen", palette.FROZEN, ring, 2.0))
    if Partition in kinds:
        key.append(("cut off", palette.CUT, ring, 2.0))
    if Jam in kinds:
        key.append(("jammed", palette.JAMMED, circle((0.0, 0.0), 0.8), 1.2))
    if Gust in kinds:
        key.append(("gust", palette.GUST, across, 1.0))
    if Kill in kinds:
        key.append(("lost", palette.GREY, ring, 2.0))
    return key


def _log_colours(stream: Part, left: float, right: float, y: float, gap: float, of_phi_g: bool) -> None:
    """A bar with the colours of φ_G, or of speed, with its ends."""
    if of_phi_g:
        entity, low, high = "map/legend/phi_G", f"φ_G ≤ {palette.PHI_G_LOW:g}", f"≥ {palette.PHI_G_HIGH:g} s⁻²"
    else:
        entity, low, high = "map/legend/speed", "speed 0", f"≥ {palette.SPEED_HIGH:g} m/s"
    marks = np.linspace(left, right, 33)
    strips = np.stack([np.stack([marks[:-1], marks[1:]], axis=-1), np.full((32, 2), y)], axis=-1)  # (32, 2, 2)
    bar = rr.LineStrips2D(
        strips.astype(np.float32), colors=palette.viridis(np.linspace(0, 1, 32)), radii=rr.Radius.ui_points(3.0)
    )
    stream.log(entity, bar)
    label(stream, f"{entity}/low", (left, y - gap), low, palette.GREY)
    label(stream, f"{entity}/high", (right, y - gap), high, palette.GREY)


def _log_wind(stream: Part, scenario: Scenario, at: Point, length: float) -> None:
    """An arrow of the mean wind's direction; the word says how fast it is."""
    wind = np.array(scenario.flown().wind.mean)
    speed = float(np.hypot(*wind))
    if speed:
        arrow = wind / speed * length
        tail = np.array([at[0], at[1] + length / 2]) - arrow / 2
        radii = rr.Radius.ui_points(1.5)
        parts = rr.Arrows2D(vectors=[arrow], origins=[tail], colors=[palette.GUST], radii=radii, draw_order=1.0)
        stream.log("map/legend/wind", parts)
    said = f"mean wind {speed:.2g} m/s" if speed else "no mean wind"
    label(stream, "map/legend/wind/word", at, said, palette.GUST)


def _log_scale(stream: Part, entity: str, at: Point, most_m: float) -> None:
    """A bar of 1, 2 or 5 times a power of ten metres, no longer than asked."""
    power = 10.0 ** math.floor(math.log10(most_m))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most_m)
    ends = np.array([(-length / 2, 0.0), (length / 2, 0.0)])
    line(stream, entity, ends + at, palette.WHITE, 1.5)
    label(stream, f"{entity}/word", at, f"{length:g} m", palette.WHITE)


def _log_close_up(stream: Part, scenario: Scenario) -> None:
    """What the close-up alone shows: its scale, and how near is near. Its frame has y down, as the view has."""
    edge = 0.9 * look.CLOSE_UP_M
    line(
        stream, f"{look.CLOSE_UP}/scale", np.array([(-edge, edge - 0.9), (1.0 - edge, edge - 0.9)]), palette.WHITE, 1.5
    )
    label(stream, f"{look.CLOSE_UP}/scale/word", (0.5 - edge, edge - 0.9), "1 m", palette.WHITE)
    hazard = scenario.metrics.hazard_radius
    line(stream, f"{look.CLOSE_UP}/hazard", circle((0.0, 0.0), hazard), palette.GREY, 1.0)
    label(stream, f"{look.CLOSE_UP}/hazard/word", (0.0, hazard), f"r_C {hazard:.2g} m", palette.GREY)
