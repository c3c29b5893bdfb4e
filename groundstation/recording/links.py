"""What a recording shows of the radio: a line on the map for every transmission, and the last round as a graph."""

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import palette
from meanflock.groundstation.recording.columns import STRIP_COLORS, STRIPS, Floats, Sent, Ticks, cut, strips
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind

LINKS_PER_TICK = 2000  # of a tick's links, as many are drawn; all are counted

_NODE_COLORS, _EDGES = rr.GraphNodes.descriptor_colors(), rr.GraphEdges.descriptor_edges()

Links = NDArray[np.int32]  # (K, 5), as in `Telemetry.links`


class LinkRows:
    """Draws the transmissions of one scenario; those of a large swarm on the map alone."""

    def __init__(self, scenario: Scenario) -> None:
        self._uavs, self._leader = scenario.uavs, scenario.federation.leader
        self._round = np.zeros((0, 5), dtype=np.int32)  # links of the last one
        names, places = look.graph(scenario)
        nodes = rr.GraphNodes.columns(node_ids=names, labels=names, positions=places)
        self._names, self._nodes = pa.array(names), nodes.partition([scenario.uavs])  # of the graph of a round

    def rows(self, ticks: Ticks, positions: Floats, links: Links) -> Iterator[Sent]:
        """Links (K, 5), the UAVs being at `positions` (T, N, 2), m, at ticks (T,)."""
        if not len(links):
            return
        links = links[np.argsort(links[:, 0], kind="stable")]
        models = links[:, 3] != FrameKind.STATE
        for entity, chosen in ((look.MODEL_LINKS, links[models]), (look.STATE_LINKS, links[~models])):
            if len(chosen):
                yield _lines(entity, ticks, positions, chosen)
        if self._uavs > look.LARGE_SWARM:
            return
        for kind in (FrameKind.UPLOAD, FrameKind.RELAY):
            of_kind = links[links[:, 3] == kind]
            if len(of_kind):
                last = of_kind[of_kind[:, 0] == of_kind[-1, 0]]
                self._round = last if kind == FrameKind.UPLOAD else np.concatenate([self._round, last])
                yield self._graph(last[:1, 0].astype(np.int64))

    def _graph(self, at: Ticks) -> Sent:
        """The last round as a graph: who got through (green), who did not (red), who was not asked (grey)."""
        sent = self._round
        colors = np.full(self._uavs, palette.GREY, dtype=np.uint32)
        colors[sent[:, 1]] = np.where(sent[:, 4] < 0, palette.RED, palette.GREEN)
        colors[self._leader] = palette.WHITE
        delivered = sent[(sent[:, 4] >= 0) & (sent[:, 1] != sent[:, 2])]
        kind = rr.components.GraphEdgeBatch._ARROW_DATATYPE
        ends = [self._names.take(pa.array(column)) for column in delivered[:, 1:3].T]
        edges = rr.components.GraphEdgeBatch(pa.StructArray.from_arrays(ends, fields=list(kind)))
        parts = (_NODE_COLORS, rr.components.ColorBatch(colors)), (_EDGES, edges)
        return look.ROUND, at, [*self._nodes, *cut(1, *parts)]


def _lines(entity: str, ticks: Ticks, positions: Floats, links: Links) -> Sent:
    """A line from source to target for every transmission, green where delivered, red where in outage."""
    _, first, count = np.unique(links[:, 0], return_index=True, return_counts=True)
    links = links[np.arange(len(links)) - np.repeat(first, count) < LINKS_PER_TICK]
    at, count = np.unique(links[:, 0], return_counts=True)
    row = np.clip(np.searchsorted(ticks, links[:, 0]), 0, len(ticks) - 1)
    ends = np.stack([positions[row, links[:, 1]], positions[row, links[:, 2]]], axis=1)  # (K, 2, 2)
    colors = np.where(links[:, 4] < 0, palette.RED, palette.GREEN).astype(np.uint32)
    parts = (STRIPS, strips(ends)), (STRIP_COLORS, rr.components.ColorBatch(colors))
    columns = [rr.ComponentColumn(descriptor, batch, lengths=count) for descriptor, batch in parts]
    return entity, at.astype(np.int64), columns
