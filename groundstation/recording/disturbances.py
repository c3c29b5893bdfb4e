"""What a recording shows of faults: on the map and in the lanes of UAVs; and the heads of clusters.

The faults of a script are known beforehand, so a recording needs no more than the ticks and where the UAVs are.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import mission, palette
from meanflock.groundstation.recording.columns import Sent, Ticks
from meanflock.groundstation.recording.marks import circle
from meanflock.swarm.clusters import Clusters
from meanflock.swarm.faults import Gust, Jam, Partition, Pause
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import POSITION, States
from meanflock.worldsim.faults import Script, words

Lasting = Pause | Partition | Jam | Gust
Part = tuple[rr.ComponentDescriptor, Any]  # and the batch that takes a list of values

_POINTS: Part = (rr.Points2D.descriptor_positions(), rr.components.Position2DBatch)
_POINT_COLORS: Part = (rr.Points2D.descriptor_colors(), rr.components.ColorBatch)
_LABELS: Part = (rr.Points2D.descriptor_labels(), rr.components.TextBatch)
_STRIPS: Part = (rr.LineStrips2D.descriptor_strips(), rr.components.LineStrip2DBatch)
_STRIP_COLORS: Part = (rr.LineStrips2D.descriptor_colors(), rr.components.ColorBatch)
_ORIGINS: Part = (rr.Arrows2D.descriptor_origins(), rr.components.Position2DBatch)
_VECTORS: Part = (rr.Arrows2D.descriptor_vectors(), rr.components.Vector2DBatch)


class _Rows:
    """Rows of an entity, each of any number of marks, also of none."""

    def __init__(self, entity: str, *parts: Part) -> None:
        self._entity, self._parts = entity, parts
        self._ticks: list[int] = []
        self._lengths: list[int] = []
        self._values: tuple[list[Any], ...] = tuple([] for _ in parts)

    def add(self, tick: int, *marks: Sequence[Any]) -> None:
        """A row; one sequence a part, all equally long."""
        self._ticks.append(tick)
        self._lengths.append(len(marks[0]))
        for values, new in zip(self._values, marks, strict=True):
            values.extend(new)

    def sent(self) -> Iterator[Sent]:
        """All rows, if there are any."""
        if self._ticks:
            columns = [
                rr.ComponentColumn(descriptor, batch(values), lengths=self._lengths)
                for (descriptor, batch), values in zip(self._parts, self._values, strict=True)
            ]
            yield self._entity, np.array(self._ticks, dtype=np.int64), columns


class Disturbances:
    """Draws the disturbances of one scenario.

    A mark stays until the next row of its entity, so it ends with an empty one: in the first tick that is seen without
    it, which need not be the next, and in the first tick of a recording that goes on where another was cut off.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._dt, self._script = scenario.dt, Script(scenario)
        self._faults = [fault for fault in scenario.faults if isinstance(fault, Lasting)]
        self._heads = Clusters(scenario).heads if scenario.federation.clusters > 1 else np.zeros(0, dtype=np.intp)
        self._shown: list[Lasting] | None = None  # what the last row shows; None: not known
        self._lanes: NDArray[np.uint8] = np.full(scenario.uavs, 255, dtype=np.uint8)  # none known yet
        low, high = mission.box(scenario)
        self._words_at = [float(0.45 * low[0] + 0.55 * high[0]), float(high[1])]

    def lanes(self, ticks: Ticks, status: NDArray[np.uint8]) -> Iterator[Sent]:
        """What the lanes of all UAVs read, at those of ticks (T,) where one changes, `status` being (T, N)."""
        lanes = self._lanes_at(ticks, status)
        changed = (np.concatenate([self._lanes[None], lanes[:-1]]) != lanes).any(axis=1)
        self._lanes = lanes[-1].copy()
        if changed.any():
            texts = [look.lane(uav, look.Lane(int(now))) for row in lanes[changed] for uav, now in enumerate(row)]
            counts = np.full(int(changed.sum()), len(self._lanes))
            yield look.LANES, ticks[changed], [*rr.StateChange.columns(state=texts).partition(counts)]

    def _lanes_at(self, ticks: Ticks, status: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`look.Lane` of every UAV, (T, N): its status, or what keeps it from flying as it would."""
        lanes = status.copy()
        for fault in self._faults:
            if isinstance(fault, Pause | Partition):
                rows = (ticks >= fault.begins(self._dt)) & (ticks < fault.ends(self._dt))
                hit = np.ix_(rows.nonzero()[0], np.array(fault.uavs, dtype=np.intp))
                lane = look.Lane.FROZEN if isinstance(fault, Pause) else look.Lane.CUT_OFF
                lanes[hit] = np.where(lanes[hit] == look.Lane.LOST, look.Lane.LOST, lane)
        return lanes

    def rows(self, ticks: Ticks, states: States) -> Iterator[Sent]:
        """The marks of ticks (T,), the UAVs being as `states` (T, N, 4) says."""
        if len(self._heads):
            heads = _Rows(look.HEADS, _POINTS)
            for tick, places in zip(ticks.tolist(), states[:, self._heads, POSITION].tolist(), strict=True):
                heads.add(tick, places)
            yield from heads.sent()
        if self._faults:
            yield from self._fault_rows(ticks, states)

    def _fault_rows(self, ticks: Ticks, states: States) -> Iterator[Sent]:
        halos, jams = _Rows(look.HALOS, _POINTS, _POINT_COLORS), _Rows(look.JAMS, _STRIPS)
        gusts, areas = _Rows(look.GUSTS, _VECTORS, _ORIGINS), _Rows(look.AREAS, _STRIPS, _STRIP_COLORS)
        said = _Rows(look.WORDS, _POINTS, _LABELS)
        for tick, now in zip(ticks.tolist(), states, strict=True):
            acting = [fault for fault in self._faults if fault.acts(tick, self._dt)]
            if not acting and self._shown == []:
                continue
            points = now[:, POSITION]
            halos.add(tick, *_halos(acting, points))
            jams.add(tick, _jammed_links(acting, points))
            gusts.add(tick, *self._gusts(tick, now))
            if acting != self._shown:
                areas.add(tick, *_areas(acting))
                texts = ["\n".join(words(fault) for fault in acting)] if acting else []
                said.add(tick, [self._words_at] * len(texts), texts)
            self._shown = acting
        for rows in (halos, jams, gusts, areas, said):
            yield from rows.sent()

    def _gusts(self, tick: int, states: States) -> tuple[list[list[float]], list[list[float]]]:
        """An arrow, and where it begins, for every UAV that is pushed."""
        pushed = self._script.gust(tick, states)
        if pushed is None:
            return [], []
        hit = (pushed != 0.0).any(axis=-1)
        return (pushed[hit] * look.GUST_S2).tolist(), states[hit, POSITION].tolist()


def _halos(acting: Sequence[Lasting], points: NDArray[np.float64]) -> tuple[list[list[float]], list[int]]:
    """A dot, larger than a UAV's, under every UAV that is frozen or cut off, and its colour."""
    frozen = sorted({uav for fault in acting if isinstance(fault, Pause) for uav in fault.uavs})
    cut = sorted({uav for fault in acting if isinstance(fault, Partition) for uav in fault.uavs})
    return points[cut + frozen].tolist(), [palette.CUT] * len(cut) + [palette.FROZEN] * len(frozen)


def _jammed_links(acting: Sequence[Lasting], points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """A line for every pair of UAVs whose link is jammed."""
    pairs = (pair for fault in acting if isinstance(fault, Jam) for pair in itertools.combinations(fault.uavs, 2))
    return [points[list(pair)] for pair in itertools.islice(pairs, look.JAMS_DRAWN)]


def _areas(acting: Sequence[Lasting]) -> tuple[list[NDArray[np.float64]], list[int]]:
    """A circle for every area, and its colour."""
    strips, colors = [], []
    for fault in acting:
        if isinstance(fault, Jam | Gust) and fault.centre is not None and fault.radius_m is not None:
            strips.append(circle(fault.centre, fault.radius_m))
            colors.append(palette.JAMMED if isinstance(fault, Jam) else palette.GUST)
    return strips, colors
