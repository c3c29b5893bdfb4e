"""The events of a flight in its recording: lines of the log, and collisions and hits on the map."""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import legend, palette, panels
from meanflock.groundstation.recording.columns import STRIPS, Floats, Sent, Ticks, cut, scalars, strips
from meanflock.groundstation.recording.plots import COLUMN
from meanflock.groundstation.recording.recorded import line
from meanflock.swarm.wire.messages import Event

LEVELS = {"dropped": "WARN", "slow": "WARN", "collision": "ERROR", "hit": "ERROR", "lost": "ERROR", "diverged": "ERROR"}
_STARS = ("collision", "hit")  # that are marked on the map
STAR_M = 1.4  # radius of a collision's star

_LEVEL_COLORS = {"INFO": palette.WHITE, "WARN": palette.ORANGE, "ERROR": palette.RED}
_TEXT, _LEVEL, _COLOR = rr.TextLog.descriptor_text(), rr.TextLog.descriptor_level(), rr.TextLog.descriptor_color()


def event_rows(ticks: Ticks, positions: Floats, swarm: NDArray[np.float64], events: Sequence[Event]) -> Iterator[Sent]:
    """Lines of the log; a collision is also a star on the map and a mark on the risk it was taken at, and an
    obstacle hit a star.

    Args:
        positions: (T, N, 2), m, at ticks (T,). swarm: (T, columns), as in `SWARM_COLUMNS`.
    """
    if not events:
        return
    levels = [LEVELS.get(event.kind, "INFO") for event in events]
    shades = [
        palette.COLLISION if event.kind in _STARS else _LEVEL_COLORS[level]
        for event, level in zip(events, levels, strict=True)
    ]
    log = (
        (_TEXT, rr.components.TextBatch([line(event) for event in events])),
        (_LEVEL, rr.components.TextLogLevelBatch(levels)),
        (_COLOR, rr.components.ColorBatch(np.array(shades, dtype=np.uint32))),
    )
    yield look.EVENTS, np.array([event.tick for event in events], dtype=np.int64), cut(len(events), *log)

    hits = [event for event in events if event.kind in _STARS and event.uavs]
    if not hits:
        return
    at = np.array([event.tick for event in hits], dtype=np.int64)
    rows = np.clip(np.searchsorted(ticks, at), 0, len(ticks) - 1)
    centres = np.stack([positions[row, list(event.uavs)].mean(axis=0) for row, event in zip(rows, hits, strict=True)])
    stars = (centres[:, None] + STAR_M * legend.STAR).astype(np.float32)  # (hits, 11, 2)
    yield look.COLLISIONS, at, cut(len(at), (STRIPS, strips(stars)))
    met = np.array([event.kind == "collision" for event in hits])
    if met.any():
        yield from scalars(panels.HITS, at[met], swarm[rows[met], COLUMN["phi_C"]])
