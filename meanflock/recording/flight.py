"""The rows that a recording gets from telemetry: UAVs and their trails, radio links, and events."""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.recording import blueprint, drawing, plots
from meanflock.recording.branches import MARK_M, MARKS, ON_MAP, Branch
from meanflock.recording.drawing import Colors, Floats, Sent, Ticks, cut
from meanflock.results.disk import LARGE_SWARM
from meanflock.results.event_log import event_level, event_text
from meanflock.results.groups import numbers
from meanflock.results.quantities import PHI_G
from meanflock.results.series import COLUMN, Reported
from meanflock.swarm import mission, state
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind, LinkColumn, Status

TRAIL_STEP_S = 0.5  # length of a piece of a trail
LINKS_PER_TICK = 2000  # links of a tick that are drawn; the numbers count all

_LEVEL_COLORS = {"INFO": drawing.WHITE, "WARN": drawing.ORANGE, "ERROR": drawing.RED}
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
    colors[status >= Status.LOST] = drawing.GREY  # or landed
    return colors


def group_colors(scenario: Scenario, ticks: Ticks, status: NDArray[np.uint8]) -> Colors:
    """Colours (T, N) of UAVs with status (T, N) at ticks (T,): those of their groups, dark on the ground."""
    groups = np.array([drawing.group_color(number) for number in numbers(scenario)], dtype=np.uint32)
    waiting = ticks[:, None] < mission.joins(scenario)
    colors = np.where(waiting | (status == Status.LANDED), drawing.dimmed(groups), groups)
    colors[status == Status.LOST] = drawing.GREY
    return colors


def uav_rows(branch: Branch, ticks: Ticks, states: state.States, colors: Colors, leader: int) -> Iterator[Sent]:
    """UAVs with states (R, N, 2d) and colours (R, N) at ticks (R,), their velocities, and the frame of the leader."""
    points = branch.within(state.position(states)).astype(np.float32)
    arrows = (branch.within(state.velocity(states)) * blueprint.ARROW_S).astype(np.float32)
    places, shades = branch.places(points), rr.components.ColorBatch(colors.reshape(-1))
    yield branch.uavs, ticks, cut(len(ticks), (branch.points, places), (branch.point_colors, shades))
    yield branch.velocity, ticks, cut(len(ticks), (branch.vectors, branch.arrows(arrows)), (branch.origins, places))
    frame = state.in_three(branch.within(state.position(states[:, leader]))).astype(np.float32)
    yield branch.leader, ticks, cut(len(ticks), (_TRANSLATION, rr.components.Translation3DBatch(frame)))


class Trails:
    """Joins positions to trails, in pieces of `TRAIL_STEP_S`; the pieces of a large swarm are straight."""

    def __init__(self, scenario: Scenario, branch: Branch) -> None:
        self._branch = branch
        self._ticks = max(1, round(TRAIL_STEP_S / scenario.dt))
        self._steps = np.arange(self._ticks + 1)
        if scenario.uavs > LARGE_SWARM:
            self._steps = self._steps[[0, -1]]
        self._start: Floats = np.empty((0, scenario.uavs, branch.axes), dtype=np.float32)  # of the next piece

    def rows(self, ticks: Ticks, positions: Floats, colors: Colors) -> Iterator[Sent]:
        """The pieces complete with the positions (T, N, axes), m, of ticks (T,), in colours (T, N) of their ends."""
        path = np.concatenate([self._start, positions])  # (P, N, axes)
        begun = len(self._start)
        pieces = (len(path) - 1) // self._ticks
        ends = np.arange(1, pieces + 1) * self._ticks
        self._start = path[pieces * self._ticks :].copy()
        if pieces:
            lines = path[ends[:, None] - self._ticks + self._steps].swapaxes(1, 2)  # (pieces, N, points, axes)
            lines = lines.reshape(-1, *lines.shape[2:])
            shades = (colors[ends - begun].reshape(-1) & ~np.uint32(0xFF)) | np.uint32(0x80)  # paler than the UAVs
            branch = self._branch
            parts = (branch.strips, branch.lines(lines)), (branch.strip_colors, rr.components.ColorBatch(shades))
            yield branch.trails, ticks[ends - begun], cut(pieces, *parts)


def with_stations(positions: Floats, scenario: Scenario) -> Floats:
    """The positions (T, N + B, axes) of all nodes, m, of UAVs at `positions` (T, N, axes)."""
    if not scenario.stations:
        return positions
    there = mission.stations(scenario)[:, : positions.shape[-1]].astype(positions.dtype)
    return np.concatenate([positions, np.broadcast_to(there, (len(positions), *there.shape))], axis=1)


def link_rows(branch: Branch, ticks: Ticks, positions: Floats, links: Links) -> Iterator[Sent]:
    """Links (K, 7) as lines, the nodes being at `positions` (T, N + B, axes), m, at ticks (T,).

    The map has those of states, too; in space these many lines would hide the UAVs.
    """
    links = links[np.argsort(links[:, LinkColumn.TICK], kind="stable")]
    models = links[:, LinkColumn.KIND] != FrameKind.STATE
    if models.any():
        yield _link_lines(branch, branch.model_links, ticks, positions, links[models])
    if branch is ON_MAP and not models.all():
        yield _link_lines(branch, blueprint.STATE_LINKS, ticks, positions, links[~models])


def _link_lines(branch: Branch, entity: str, ticks: Ticks, positions: Floats, links: Links) -> Sent:
    """A line from source to target for every transmission, green where delivered, red where in outage."""
    _, first, count = np.unique(links[:, LinkColumn.TICK], return_index=True, return_counts=True)
    links = links[np.arange(len(links)) - np.repeat(first, count) < LINKS_PER_TICK]
    at, count = np.unique(links[:, LinkColumn.TICK], return_counts=True)
    row = np.clip(np.searchsorted(ticks, links[:, LinkColumn.TICK]), 0, len(ticks) - 1)
    ends = np.stack(
        [positions[row, links[:, LinkColumn.SOURCE]], positions[row, links[:, LinkColumn.TARGET]]], axis=1
    )  # (K, 2, axes)
    colors = np.where(links[:, LinkColumn.DELIVERED] > 0, drawing.GREEN, drawing.RED).astype(np.uint32)
    parts = (branch.strips, branch.lines(ends)), (branch.strip_colors, rr.components.ColorBatch(colors))
    columns = [rr.ComponentColumn(descriptor, batch, lengths=count) for descriptor, batch in parts]
    return entity, at.astype(np.int64), columns


def event_rows(ticks: Ticks, swarm: NDArray[np.float64], events: Sequence[FlightEvent]) -> Iterator[Sent]:
    """Lines of the log, and a mark on the risk at each collision.

    Args:
        swarm: (T, columns), as in `SWARM_COLUMNS`, at ticks (T,).
    """
    if not events:
        return
    levels = [event_level(event) for event in events]
    shades = [
        MARKS[event.kind].color if event.kind in MARKS else _LEVEL_COLORS[level]
        for event, level in zip(events, levels, strict=True)
    ]
    log = (
        (_TEXT, rr.components.TextBatch([event_text(event) for event in events])),
        (_LEVEL, rr.components.TextLogLevelBatch(levels)),
        (_COLOR, rr.components.ColorBatch(np.array(shades, dtype=np.uint32))),
    )
    yield blueprint.EVENTS, np.array([event.tick for event in events], dtype=np.int64), cut(len(events), *log)
    at, rows = _ticks_of(_marked(events, "collision"), ticks)
    yield from drawing.scalars(plots.HITS, at, swarm[rows, COLUMN["phi_C"]])


def mark_rows(branch: Branch, ticks: Ticks, positions: Floats, events: Sequence[FlightEvent]) -> Iterator[Sent]:
    """Marks at the events of UAVs at `positions` (T, N, axes), m, at ticks (T,)."""
    for kind, mark in MARKS.items():
        marked = _marked(events, kind)
        if not marked:
            continue
        at, rows = _ticks_of(marked, ticks)
        places = [positions[row, list(event.uavs)].mean(axis=0) for row, event in zip(rows, marked, strict=True)]
        shape = MARK_M * (mark.on_map if branch is ON_MAP else mark.in_space)
        points = (np.stack(places)[:, None] + shape).astype(np.float32)  # (marked, points of the mark, axes)
        yield branch.marks[kind], at, cut(len(at), (branch.strips, branch.lines(points)))


def _marked(events: Sequence[FlightEvent], kind: str) -> list[FlightEvent]:
    return [event for event in events if event.kind == kind and event.uavs]


def _ticks_of(events: Sequence[FlightEvent], ticks: Ticks) -> tuple[Ticks, NDArray[np.intp]]:
    """Ticks of events, and the row of each in ticks (T,)."""
    at = np.array([event.tick for event in events], dtype=np.int64)
    return at, np.clip(np.searchsorted(ticks, at), 0, len(ticks) - 1)
