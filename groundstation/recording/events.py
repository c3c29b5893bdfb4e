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
MARK_M = 1.4  # radius of a mark on the map
# What is marked on the map: as what, and in which colour.
MARKS = {
    "collision": (look.COLLISIONS, legend.STAR, palette.COLLISION),
    "hit": (look.OBSTACLE_HITS, legend.CROSS, palette.HIT),
}

_LEVEL_COLORS = {"INFO": palette.WHITE, "WARN": palette.ORANGE, "ERROR": palette.RED}
_TEXT, _LEVEL, _COLOR = rr.TextLog.descriptor_text(), rr.TextLog.descriptor_level(), rr.TextLog.descriptor_color()


def event_rows(ticks: Ticks, positions: Floats, swarm: NDArray[np.float64], events: Sequence[Event]) -> Iterator[Sent]:
    """Lines of the log; a collision is also a star on the map and a mark on the risk it was taken at, an obstacle hit
    a cross on the map.

    Args:
        positions: (T, N, 2), m, at ticks (T,). swarm: (T, columns), as in `SWARM_COLUMNS`.
    """
    if not events:
        return
    levels = [LEVELS.get(event.kind, "INFO") for event in events]
    shades = [
        MARKS[event.kind][2] if event.kind in MARKS else _LEVEL_COLORS[level]
        for event, level in zip(events, levels, strict=True)
    ]
    log = (
        (_TEXT, rr.components.TextBatch([line(event) for event in events])),
        (_LEVEL, rr.components.TextLogLevelBatch(levels)),
        (_COLOR, rr.components.ColorBatch(np.array(shades, dtype=np.uint32))),
    )
    yield look.EVENTS, np.array([event.tick for event in events], dtype=np.int64), cut(len(events), *log)

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
            yield from scalars(panels.HITS, at, swarm[rows, COLUMN["phi_C"]])
