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
from meanflock.swarm.faults import Gust, Jam, Kill, Partition, Pause
from meanflock.swarm.scenario import Scenario

_COLUMNS = 2
_ROW = 1 / 12  # of the key's height, at the most
_SAMPLE, _SCALE = 0.16, 0.7  # lengths of a sample, and of the bar that shows the scale at the most, in columns
_CORNERS = np.arange(11) * (math.pi / 5) + math.pi / 2
STAR = np.stack([np.cos(_CORNERS), np.sin(_CORNERS)], axis=-1) * np.where(np.arange(11) % 2, 0.4, 1.0)[:, None]

CROSS = np.array([(-1.0, -1.0), (1.0, 1.0), (0.0, 0.0), (-1.0, 1.0), (1.0, -1.0)]) * math.sqrt(0.5)


class Layout(NamedTuple):
    """Where the key stands: middle of its upper left sample, its columns and rows, the length of a sample, m."""

    left: float
    top: float
    column: float
    row: float
    sample: float


def layout(scenario: Scenario, words: int, maps: int = 1) -> Layout:
    """The place for a key of so many `words` beside the map, which is one of several `maps`.

    It begins level with the mission, or in the middle of the view where it is higher than the mission.
    """
    low, high = recording_mission.key_box(scenario, maps)
    column = float(high[0] - low[0]) / _COLUMNS
    lines = 2 + math.ceil(words / _COLUMNS)
    row = float(high[1] - low[1]) * min(_ROW * recording_mission.shape(maps)[0], 1 / lines)
    mission_low, mission_high = recording_mission.box(scenario)
    top = max(float(mission_high[1]), float(mission_low[1] + mission_high[1] + lines * row) / 2)
    return Layout(low[0] + column / 2, top - row / 2, column, row, _SAMPLE * column)


def log(stream: Part, scenario: Scenario, reported: Reported, maps: int = 1) -> None:
    """Logs the map's fixed parts, and those of the close-up on the leader; `maps`: in the same window."""
    key = _key(scenario)
    left, top, column, row, sample = layout(scenario, len(key), maps)
    recording_mission.log(stream, scenario)
    _log_wind(stream, scenario, (left, top), 0.6 * row)
    _log_scale(stream, "map/legend/scale", (left + column, top), _SCALE * column)
    _log_colours(stream, left, left + column, top - row, 0.2 * sample, reported.has_phi_g)
    for number, (word, color, shape, thickness) in enumerate(key):
        at = left + number % _COLUMNS * column, top - (2 + number // _COLUMNS) * row
        entity = f"map/legend/{word.replace(' ', '_')}"
        line(stream, entity, shape * sample / 2 + at, color, thickness)
        label(stream, f"{entity}/word", (at[0], at[1] - 0.2 * sample), word, color)
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
        key += [("obstacle", palette.GREY, ring, 1.0), ("obstacle hit", palette.HIT, 0.7 * CROSS, 1.5)]
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
