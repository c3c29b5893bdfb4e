"""The rows that a recording gets from telemetry: UAVs and their trails, radio links, and events."""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.recording import blueprint, drawing, plots
from meanflock.recording.drawing import STRIP_COLORS, STRIPS, Colors, Floats, Sent, Ticks, cut, strips
from meanflock.results.disk import LARGE_SWARM
from meanflock.results.event_log import event_level, event_text
from meanflock.results.quantities import PHI_G
from meanflock.results.series import COLUMN, Reported
from meanflock.swarm import mission, state
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind, LinkColumn, Status

TRAIL_STEP_S = 0.5  # length of a piece of a trail
LINKS_PER_TICK = 2000  # links of a tick that are drawn; the numbers count all

_LEVEL_COLORS = {"INFO": drawing.WHITE, "WARN": drawing.ORANGE, "ERROR": drawing.RED}
MARK_M = 1.4  # radius of an event's mark on the map
MARKS = {  # kinds of events with a mark: entity, shape, colour
    "collision": (blueprint.COLLISIONS, drawing.STAR, drawing.COLLISION),
    "hit": (blueprint.OBSTACLE_HITS, drawing.CROSS, drawing.HIT),
}

_POINTS, _COLORS = rr.Points2D.descriptor_positions(), rr.Points2D.descriptor_colors()
_VECTORS, _ORIGINS = rr.Arrows2D.descriptor_vectors(), rr.Arrows2D.descriptor_origins()
_TRANSLATION = rr.Transform3D.descriptor_translation()
_TEXT = rr.TextLog.descriptor_text()
_LEVEL = rr.TextLog.descriptor_level()
_COLOR = rr.TextLog.descriptor_color()

Links = NDArray[np.int32]  # (K, 7), as in `Telemetry.links`


def uav_colors(states: state.States, diagnostics: Floats, status: NDArray[np.uint8], reported: Reported) -> Colors:
    """Colours (T, N) of UAVs with states (T, N, 4), diagnostics (T, N, K) and status (T, N): by φ_G where the
    controller reports it, else by speed.
    """
    if reported.has_phi_g:
        colors = drawing.phi_g_colors(diagnostics[..., reported.diagnostics.index(PHI_G)])
    else:
        colors = drawing.speed_colors(state.speed(states))
    colors[status == Status.LOST] = drawing.GREY
    return colors


def uav_rows(ticks: Ticks, states: state.States, colors: Colors, leader: int) -> Iterator[Sent]:
    """UAVs with states (R, N, 4) and colours (R, N) at ticks (R,), their velocities, and the frame of the leader."""
    points = state.flat(states).astype(np.float32)
    arrows = (state.flat(state.velocity(states)) * blueprint.ARROW_S).astype(np.float32)
    places = rr.components.Position2DBatch(points.reshape(-1, 2))
    shades = rr.components.ColorBatch(colors.reshape(-1))
    vectors = rr.components.Vector2DBatch(arrows.reshape(-1, 2))
    yield blueprint.UAVS, ticks, cut(len(ticks), (_POINTS, places), (_COLORS, shades))
    yield blueprint.VELOCITY, ticks, cut(len(ticks), (_VECTORS, vectors), (_ORIGINS, places))
    origin = points[:, leader]
    frame = np.concatenate([origin, np.zeros_like(origin[:, :1])], axis=-1)
    yield blueprint.LEADER, ticks, cut(len(ticks), (_TRANSLATION, rr.components.Translation3DBatch(frame)))


class Trails:
    """Joins positions to trails, in pieces of `TRAIL_STEP_S`; the pieces of a large swarm are straight."""

    def __init__(self, scenario: Scenario) -> None:
        self._ticks = max(1, round(TRAIL_STEP_S / scenario.dt))
        self._steps = np.arange(self._ticks + 1)
        if scenario.uavs > LARGE_SWARM:
            self._steps = self._steps[[0, -1]]
        self._start: Floats = np.empty((0, scenario.uavs, 2), dtype=np.float32)  # of the next piece

    def rows(self, ticks: Ticks, positions: Floats, colors: Colors) -> Iterator[Sent]:
        """The pieces complete with the positions (T, N, 2), m, of ticks (T,), in the colours (T, N) of their ends."""
        path = np.concatenate([self._start, positions])  # (P, N, 2)
        begun = len(self._start)
        pieces = (len(path) - 1) // self._ticks
        ends = np.arange(1, pieces + 1) * self._ticks
        self._start = path[pieces * self._ticks :].copy()
        if pieces:
            lines = path[ends[:, None] - self._ticks + self._steps].swapaxes(1, 2)  # (pieces, N, points, 2)
            lines = lines.reshape(-1, *lines.shape[2:])
            shades = (colors[ends - begun].reshape(-1) & ~np.uint32(0xFF)) | np.uint32(0x80)  # paler than the UAVs
            parts = (STRIPS, strips(lines)), (STRIP_COLORS, rr.components.ColorBatch(shades))
            yield blueprint.TRAILS, ticks[ends - begun], cut(pieces, *parts)


def with_stations(positions: Floats, scenario: Scenario) -> Floats:
    """The positions (T, N + B, 2) of all nodes, m, of UAVs at `positions` (T, N, 2)."""
    if not scenario.stations:
        return positions
    there = mission.stations(scenario)[:, :2].astype(positions.dtype)
    return np.concatenate([positions, np.broadcast_to(there, (len(positions), *there.shape))], axis=1)


def link_rows(ticks: Ticks, positions: Floats, links: Links) -> Iterator[Sent]:
    """Links (K, 7) as lines on the map, the nodes being at `positions` (T, N + B, 2), m, at ticks (T,)."""
    links = links[np.argsort(links[:, LinkColumn.TICK], kind="stable")]
    models = links[:, LinkColumn.KIND] != FrameKind.STATE
    for entity, chosen in ((blueprint.MODEL_LINKS, links[models]), (blueprint.STATE_LINKS, links[~models])):
        if len(chosen):
            yield _link_lines(entity, ticks, positions, chosen)


def _link_lines(entity: str, ticks: Ticks, positions: Floats, links: Links) -> Sent:
    """A line from source to target for every transmission, green where delivered, red where in outage."""
    _, first, count = np.unique(links[:, LinkColumn.TICK], return_index=True, return_counts=True)
    links = links[np.arange(len(links)) - np.repeat(first, count) < LINKS_PER_TICK]
    at, count = np.unique(links[:, LinkColumn.TICK], return_counts=True)
    row = np.clip(np.searchsorted(ticks, links[:, LinkColumn.TICK]), 0, len(ticks) - 1)
    ends = np.stack(
        [positions[row, links[:, LinkColumn.SOURCE]], positions[row, links[:, LinkColumn.TARGET]]], axis=1
    )  # (K, 2, 2)
    colors = np.where(links[:, LinkColumn.DELIVERED] > 0, drawing.GREEN, drawing.RED).astype(np.uint32)
    parts = (STRIPS, strips(ends)), (STRIP_COLORS, rr.components.ColorBatch(colors))
    columns = [rr.ComponentColumn(descriptor, batch, lengths=count) for descriptor, batch in parts]
    return entity, at.astype(np.int64), columns


def event_rows(
    ticks: Ticks, positions: Floats, swarm: NDArray[np.float64], events: Sequence[FlightEvent]
) -> Iterator[Sent]:
    """Lines of the log, marks on the map, and a mark on the risk at each collision.

    Args:
        positions: (T, N, 2), m, at ticks (T,). swarm: (T, columns), as in `SWARM_COLUMNS`.
    """
    if not events:
        return
    levels = [event_level(event) for event in events]
    shades = [
        MARKS[event.kind][2] if event.kind in MARKS else _LEVEL_COLORS[level]
        for event, level in zip(events, levels, strict=True)
    ]
    log = (
        (_TEXT, rr.components.TextBatch([event_text(event) for event in events])),
        (_LEVEL, rr.components.TextLogLevelBatch(levels)),
        (_COLOR, rr.components.ColorBatch(np.array(shades, dtype=np.uint32))),
    )
    yield blueprint.EVENTS, np.array([event.tick for event in events], dtype=np.int64), cut(len(events), *log)

    for kind, (entity, mark, _) in MARKS.items():
        marked = [event for event in events if event.kind == kind and event.uavs]
        if not marked:
            continue
        at = np.array([event.tick for event in marked], dtype=np.int64)
        rows = np.clip(np.searchsorted(ticks, at), 0, len(ticks) - 1)
        places = [positions[row, list(event.uavs)].mean(axis=0) for row, event in zip(rows, marked, strict=True)]
        points = (np.stack(places)[:, None] + MARK_M * mark).astype(np.float32)  # (marked, points of the mark, 2)
        yield entity, at, cut(len(at), (STRIPS, strips(points)))
        if kind == "collision":
            yield from drawing.scalars(plots.HITS, at, swarm[rows, COLUMN["phi_C"]])
