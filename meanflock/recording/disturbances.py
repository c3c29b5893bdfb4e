"""The rows that a recording gets from the fault script, on the map and in the lanes of UAVs; and heads of clusters.

The script is fixed before take-off, so the rows need only the ticks and the states of the UAVs.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.federation.topology.clusters import Division
from meanflock.recording import blueprint, drawing, mission_map
from meanflock.recording.blueprint import Lane
from meanflock.recording.drawing import Sent, Ticks, circle
from meanflock.results.groups import uav_names
from meanflock.swarm import mission, state
from meanflock.swarm.faults import Fault, Gust, Interference, Jam, Kill, Partition, Pause, nodes_hit
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import States
from meanflock.worldsim.faults import Script, words

Lasting = Pause | Partition | Jam | Interference | Gust
Component = tuple[rr.ComponentDescriptor, Any]  # with what makes a batch of a list of its values


def _color_batch(colors: Sequence[int]) -> rr.components.ColorBatch:
    return rr.components.ColorBatch(drawing.rgba(colors))


_POINTS: Component = (rr.Points2D.descriptor_positions(), rr.components.Position2DBatch)
_POINT_COLORS: Component = (rr.Points2D.descriptor_colors(), _color_batch)
_LABELS: Component = (rr.Points2D.descriptor_labels(), rr.components.TextBatch)
_STRIPS: Component = (rr.LineStrips2D.descriptor_strips(), rr.components.LineStrip2DBatch)
_STRIP_COLORS: Component = (rr.LineStrips2D.descriptor_colors(), _color_batch)
_ORIGINS: Component = (rr.Arrows2D.descriptor_origins(), rr.components.Position2DBatch)
_VECTORS: Component = (rr.Arrows2D.descriptor_vectors(), rr.components.Vector2DBatch)


class _Rows:
    """Rows of an entity, with any number of marks each."""

    def __init__(self, entity: str, *components: Component) -> None:
        self._entity, self._components = entity, components
        self._ticks: list[int] = []
        self._lengths: list[int] = []
        self._values: tuple[list[Any], ...] = tuple([] for _ in components)

    def add(self, tick: int, *marks: Sequence[Any]) -> None:
        """Adds a row; `marks` has a sequence for each component, all equally long."""
        self._ticks.append(tick)
        self._lengths.append(len(marks[0]))
        for values, new in zip(self._values, marks, strict=True):
            values.extend(new)

    def sent(self) -> Iterator[Sent]:
        """All rows."""
        if self._ticks:
            columns = [
                rr.ComponentColumn(descriptor, batch(values), lengths=self._lengths)
                for (descriptor, batch), values in zip(self._components, self._values, strict=True)
            ]
            yield self._entity, np.array(self._ticks, dtype=np.int64), columns


class Disturbances:
    """Draws the faults and the heads of one scenario.

    A mark is shown until the next row of its entity. So it ends with an empty row: in the first recorded tick after
    the fault, and in the first tick of a recording that continues another.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._dt, self._script = scenario.dt, Script(scenario)
        self._faults = [fault for fault in scenario.faults if isinstance(fault, Lasting)]
        self._kills = [fault for fault in scenario.faults if isinstance(fault, Kill) and fault.stations]
        self._names, self._joins = uav_names(scenario), mission.joins(scenario)
        self._stations, self._uavs = mission.stations(scenario)[:, :2], scenario.uavs
        self._heads = Division(scenario).heads if scenario.federation.clusters > 1 else np.zeros(0, dtype=np.intp)
        self._shown: list[Fault] | None = None  # faults in the last row; None: there is no row
        self._lanes: NDArray[np.uint8] = np.full(scenario.uavs, 255, dtype=np.uint8)  # likewise; 255: there is no row
        low, high = mission_map.box(scenario)
        self._jammer = mission_map.STATION * float((high - low).max()) * drawing.CROSS
        self._words_at = [float(0.45 * low[0] + 0.55 * high[0]), float(high[1])]

    def lanes(self, ticks: Ticks, status: NDArray[np.uint8]) -> Iterator[Sent]:
        """Lanes of all UAVs with `status` (T, N), at those of the ticks (T,) at which any lane changes."""
        lanes = self._lanes_at(ticks, status)
        changed = (np.concatenate([self._lanes[None], lanes[:-1]]) != lanes).any(axis=1)
        self._lanes = lanes[-1].copy()
        if changed.any():
            named = [zip(self._names, row.tolist(), strict=True) for row in lanes[changed]]
            texts = [blueprint.lane(name, Lane(now)) for row in named for name, now in row]
            counts = np.full(int(changed.sum()), len(self._lanes))
            yield blueprint.LANES, ticks[changed], [*rr.StateChange.columns(state=texts).partition(counts)]

    def _lanes_at(self, ticks: Ticks, status: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`Lane` of every UAV, (T, N): its status, or what holds it: a fault, or that its group has not joined."""
        lanes = status.copy()
        for fault in self._faults:
            if isinstance(fault, Pause | Partition):
                rows = (ticks >= fault.begins(self._dt)) & (ticks < fault.ends(self._dt))
                hit = np.ix_(rows.nonzero()[0], np.array(fault.uavs, dtype=np.intp))
                lane = Lane.FROZEN if isinstance(fault, Pause) else Lane.CUT_OFF
                lanes[hit] = np.where(lanes[hit] == Lane.LOST, Lane.LOST, lane)
        lanes[ticks[:, None] < self._joins] = Lane.WAITING
        return lanes

    def rows(self, ticks: Ticks, states: States) -> Iterator[Sent]:
        """The marks of ticks (T,) with the `states` (T, N, 4) of the UAVs."""
        if len(self._heads):
            heads = _Rows(blueprint.HEADS, _POINTS)
            for tick, places in zip(ticks.tolist(), state.flat(states[:, self._heads]).tolist(), strict=True):
                heads.add(tick, places)
            yield from heads.sent()
        if self._faults or self._kills:
            yield from self._fault_rows(ticks, states)

    def _fault_rows(self, ticks: Ticks, states: States) -> Iterator[Sent]:
        halos, jams = _Rows(blueprint.HALOS, _POINTS, _POINT_COLORS), _Rows(blueprint.JAMS, _STRIPS)
        gusts, areas = _Rows(blueprint.GUSTS, _VECTORS, _ORIGINS), _Rows(blueprint.AREAS, _STRIPS, _STRIP_COLORS)
        texts = _Rows(blueprint.WORDS, _POINTS, _LABELS)
        for tick, now in zip(ticks.tolist(), states, strict=True):
            acting: list[Fault] = [fault for fault in self._faults if fault.acts(tick, self._dt)]
            acting += [fault for fault in self._kills if fault.begins(self._dt) <= tick]
            if not acting and self._shown == []:
                continue
            points = np.concatenate([state.flat(now), self._stations])
            halos.add(tick, *self._halos(acting, points))
            jams.add(tick, self._jammed_links(acting, points))
            gusts.add(tick, *self._gusts(tick, now))
            if acting != self._shown:
                areas.add(tick, *self._areas(acting))
                labels = ["\n".join(words(fault) for fault in acting)] if acting else []
                texts.add(tick, [self._words_at] * len(labels), labels)
            self._shown = acting
        for rows in (halos, jams, gusts, areas, texts):
            yield from rows.sent()

    def _gusts(self, tick: int, states: States) -> tuple[list[list[float]], list[list[float]]]:
        """Vector and origin of an arrow for every UAV in a gust."""
        pushed = self._script.gust(tick, states)
        if pushed is None:
            return [], []
        hit = (pushed != 0.0).any(axis=-1)
        return (state.flat(pushed[hit]) * blueprint.GUST_S2).tolist(), state.flat(states[hit]).tolist()

    def _halos(self, acting: Sequence[Fault], points: NDArray[np.float64]) -> tuple[list[list[float]], list[int]]:
        """A dot, larger than a UAV's, under every node that is frozen or cut off, or a lost station, and its colour."""
        frozen = sorted({node for fault in acting if isinstance(fault, Pause) for node in nodes_hit(fault, self._uavs)})
        cut = sorted(
            {node for fault in acting if isinstance(fault, Partition) for node in nodes_hit(fault, self._uavs)}
        )
        lost = sorted({self._uavs + one for fault in acting if isinstance(fault, Kill) for one in fault.stations})
        colors = [drawing.CUT] * len(cut) + [drawing.FROZEN] * len(frozen) + [drawing.GREY] * len(lost)
        return points[cut + frozen + lost].tolist(), colors

    def _jammed_links(self, acting: Sequence[Fault], points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """A line for every pair of nodes whose link is jammed."""
        jams = (fault for fault in acting if isinstance(fault, Jam))
        pairs = (pair for fault in jams for pair in itertools.combinations(nodes_hit(fault, self._uavs), 2))
        return [points[list(pair)] for pair in itertools.islice(pairs, blueprint.JAMS_DRAWN)]

    def _areas(self, acting: Sequence[Fault]) -> tuple[list[NDArray[np.float64]], list[int]]:
        """A circle for every area and a cross for every jammer that sends noise, and its colour."""
        strips, colors = [], []
        for fault in acting:
            if isinstance(fault, Jam | Gust) and fault.centre is not None and fault.radius_m is not None:
                strips.append(circle(fault.centre, fault.radius_m))
                colors.append(drawing.JAMMED if isinstance(fault, Jam) else drawing.GUST)
            elif isinstance(fault, Interference):
                strips.append(self._jammer + fault.place[:2])
                colors.append(drawing.JAMMED)
        return strips, colors
