"""What the map of a recording shows of motion: the UAVs, their velocities and trails, and the frame of the leader."""

from collections.abc import Iterator

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import palette
from meanflock.groundstation.recording.columns import STRIP_COLORS, STRIPS, Floats, Sent, Ticks, cut, strips
from meanflock.groundstation.reported import PHI_G, Reported
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status

TRAIL_STEP_S = 0.5  # a trail is made of pieces this long

_POINTS, _COLORS = rr.Points2D.descriptor_positions(), rr.Points2D.descriptor_colors()
_VECTORS, _ORIGINS = rr.Arrows2D.descriptor_vectors(), rr.Arrows2D.descriptor_origins()
_TRANSLATION = rr.Transform3D.descriptor_translation()

Colors = NDArray[np.uint32]  # 0xRRGGBBAA


def uav_colors(states: state.States, diagnostics: Floats, status: NDArray[np.uint8], reported: Reported) -> Colors:
    """Colours (T, N) of UAVs with states (T, N, 4), diagnostics (T, N, K) and status (T, N): by φ_G where the
    controller reports it, else by speed.
    """
    if reported.has_phi_g:
        colors = palette.phi_g_colors(diagnostics[..., reported.diagnostics.index(PHI_G)])
    else:
        colors = palette.speed_colors(state.speed(states))
    colors[status == Status.LOST] = palette.GREY
    return colors


def uav_rows(ticks: Ticks, states: state.States, colors: Colors, leader: int) -> Iterator[Sent]:
    """UAVs with states (R, N, 4) and colours (R, N) at ticks (R,), their velocities, and the frame of the leader."""
    points = states[..., state.POSITION].astype(np.float32)
    arrows = (states[..., state.VELOCITY] * look.ARROW_S).astype(np.float32)
    places = rr.components.Position2DBatch(points.reshape(-1, 2))
    shades = rr.components.ColorBatch(colors.reshape(-1))
    vectors = rr.components.Vector2DBatch(arrows.reshape(-1, 2))
    yield look.UAVS, ticks, cut(len(ticks), (_POINTS, places), (_COLORS, shades))
    yield look.VELOCITY, ticks, cut(len(ticks), (_VECTORS, vectors), (_ORIGINS, places))
    origin = points[:, leader]
    frame = np.concatenate([origin, np.zeros_like(origin[:, :1])], axis=-1)
    yield look.LEADER, ticks, cut(len(ticks), (_TRANSLATION, rr.components.Translation3DBatch(frame)))


class Trails:
    """Joins positions to trails, a piece of all UAVs every `TRAIL_STEP_S`; those of a large swarm are straight."""

    def __init__(self, scenario: Scenario) -> None:
        self._ticks = max(1, round(TRAIL_STEP_S / scenario.dt))
        self._steps = np.arange(self._ticks + 1)
        if scenario.uavs > look.LARGE_SWARM:
            self._steps = self._steps[[0, -1]]
        self._start: Floats = np.empty((0, scenario.uavs, 2), dtype=np.float32)  # not yet in a piece

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
            shades = (colors[ends - begun].reshape(-1) & ~np.uint32(0xFF)) | np.uint32(0x80)  # the dots stand out
            parts = (STRIPS, strips(lines)), (STRIP_COLORS, rr.components.ColorBatch(shades))
            yield look.TRAILS, ticks[ends - begun], cut(pieces, *parts)
