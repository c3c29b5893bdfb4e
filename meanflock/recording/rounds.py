"""The rows that a recording gets of the rounds: each round as a graph, and the shares of uploads in a plot.

The links of a round come while it is open, its event at its end. So a graph shows first what was delivered, and then
also which UAVs were silent, late or refused.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from meanflock.federation.schedule import drawn
from meanflock.recording import blueprint, plots
from meanflock.recording.drawing import Colors, Sent, Ticks, cut, scalars
from meanflock.results.disk import LARGE_SWARM
from meanflock.swarm import faults, mission
from meanflock.swarm.events import FlightEvent, RoundEnded, UploadsRefused
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Mask
from meanflock.swarm.wire.messages import FrameKind, LinkColumn, Status

Links = NDArray[np.int32]  # (K, 7), as in `Telemetry.links`

EDGES = 2000  # of a graph, at most; the colours and the plot count all

_COLORS, _LABELS = rr.GraphNodes.descriptor_colors(), rr.GraphNodes.descriptor_labels()
_EDGES = rr.GraphEdges.descriptor_edges()
_NO_LINKS = np.zeros((0, len(LinkColumn)), dtype=np.int32)


class Drawing(NamedTuple):
    """The graph of a round in a tick: colours of the nodes (N + B,), their labels, and the edges, (E, 2)."""

    colors: Colors
    labels: list[str]
    edges: NDArray[np.int32]


class RoundRows:
    """Draws the rounds of one scenario. A large swarm has no graph."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = blueprint.resolved(scenario)
        self._is_drawn = scenario.uavs <= LARGE_SWARM
        self._names = blueprint.nodes(scenario)
        self._centre = blueprint.centre(scenario)
        self._links = _NO_LINKS  # of the last round
        self._last, self._is_over = -1, True  # tick of its last links, and whether its event has come
        self._refused: set[int] = set()

    def rows(
        self, ticks: Ticks, links: Links, events: Sequence[FlightEvent], status: NDArray[np.uint8]
    ) -> Iterator[Sent]:
        """The rounds, by links (K, 7), events, and status (T, N) at ticks (T,); all follow those of earlier calls."""
        ended = [event for event in events if isinstance(event, RoundEnded)]
        ends = np.array([each.tick for each in ended], dtype=np.int64)
        yield from scalars(plots.ROUNDS.entity, ends, plots.percentages(ended))
        if self._is_drawn:
            gone = status[np.clip(np.searchsorted(ticks, ends), 0, len(ticks) - 1)] >= Status.LOST  # or landed
            gone |= ends[:, None] < mission.joins(self._scenario)
            yield from self._graphs(links, events, ended, gone)

    def _graphs(
        self, links: Links, events: Sequence[FlightEvent], ended: list[RoundEnded], gone: NDArray[np.bool_]
    ) -> Iterator[Sent]:
        links = links[(links[:, LinkColumn.KIND] == FrameKind.UPLOAD) | (links[:, LinkColumn.KIND] == FrameKind.RELAY)]
        refusals = [event for event in events if isinstance(event, UploadsRefused)]
        at = sorted({*links[:, LinkColumn.TICK].tolist(), *(each.tick for each in ended)})
        drawings: list[Drawing] = []
        for tick in at:
            self._add(links[links[:, LinkColumn.TICK] == tick])
            colors, labels = self._provisional(), self._names
            self._refused.update(uav for event in refusals if event.tick == tick for uav in event.uavs)
            for each, absent in zip(ended, gone, strict=True):
                if each.tick == tick:
                    colors, labels = self._final(each, absent), self._labelled(each, absent)
                    self._is_over = True
            drawings.append(Drawing(colors, labels, self._edges()))
        if drawings:
            yield blueprint.ROUND, np.array(at, dtype=np.int64), self._columns(drawings)

    def _add(self, links: Links) -> None:
        """Adds the links of a tick to the round; the first uploads after the end of a round begin another."""
        if not len(links):
            return
        tick = int(links[0, 0])
        is_upload = bool((links[:, LinkColumn.KIND] == FrameKind.UPLOAD).any())
        if is_upload and (self._is_over or tick > self._last + 1):  # fragments are transmitted in ticks on end
            self._links, self._refused = _NO_LINKS, set()
        self._links = np.concatenate([self._links, links])
        self._last = tick
        self._is_over = False

    def _late(self) -> NDArray[np.bool_]:
        """Mask (K,) of the links that deliver after the deadline."""
        scenario = self._scenario
        if scenario.federation.deadline is None:
            return np.zeros(len(self._links), dtype=bool)
        is_upload = self._links[:, LinkColumn.KIND] == FrameKind.UPLOAD
        spent = self._links[:, LinkColumn.WAITED] + self._links[:, LinkColumn.SLOTS]
        return np.asarray(is_upload & (scenario.delivery_ticks(spent) > scenario.deadline_ticks))

    def _provisional(self) -> Colors:
        """Colours by the links alone, (N + B,)."""
        links = self._links
        colors = np.full(len(self._names), blueprint.OUTCOMES["no part"], dtype=np.uint32)
        late = self._late()
        through = links[:, LinkColumn.DELIVERED] > 0
        for name, chosen in (("lost", ~through), ("late", through & late), ("received", through & ~late)):
            colors[links[chosen, LinkColumn.SOURCE]] = blueprint.OUTCOMES[name]
        if self._centre is not None:
            colors[self._centre] = blueprint.CENTRE
        return colors

    def _final(self, ended: RoundEnded, absent: Mask) -> Colors:
        """Colours at the end of the round, (N + B,). absent: (N,), UAVs that are lost, landed or have not joined."""
        colors, scenario = self._provisional(), self._scenario
        sent = np.array(ended.sent, dtype=np.intp)
        paused = faults.paused(scenario.faults, ended.opened, scenario.dt)
        silent = np.setdiff1d(drawn(scenario, ended.number), [*sent, *np.flatnonzero(absent), *paused])
        colors[silent] = blueprint.OUTCOMES["silent"]
        own = np.setdiff1d(sent, self._links[:, LinkColumn.SOURCE])  # no UAV in range, or the UAV that averages
        colors[own] = blueprint.OUTCOMES["received" if self._centre is not None else "lost"]
        colors[list(self._refused)] = blueprint.OUTCOMES["refused"]
        if self._centre is not None:
            colors[self._centre] = blueprint.CENTRE
        return colors

    def _labelled(self, ended: RoundEnded, absent: Mask) -> list[str]:
        """Names of the UAVs, with a word at those that received nothing and average for themselves."""
        if not ended.isolated:
            return self._names
        received = {*self._delivered()[:, 2].tolist(), *np.flatnonzero(absent).tolist()}
        return [name if uav in received else f"{name} isolated" for uav, name in enumerate(self._names)]

    def _delivered(self) -> Links:
        """The links of the round that delivered in time, between different UAVs."""
        links = self._links[(self._links[:, LinkColumn.DELIVERED] > 0) & ~self._late()]
        return links[links[:, LinkColumn.SOURCE] != links[:, LinkColumn.TARGET]]

    def _edges(self) -> NDArray[np.int32]:
        """The pairs of UAVs between which an upload or an average was delivered, (E, 2), at most `EDGES`."""
        links, count = self._delivered(), len(self._names)
        pairs = np.unique(links[:, LinkColumn.SOURCE] * count + links[:, LinkColumn.TARGET])[:EDGES]
        return np.stack(np.divmod(pairs, count), axis=-1)

    def _columns(self, drawings: list[Drawing]) -> list[rr.ComponentColumn]:
        """The columns of some graphs, each with all nodes, those of the key included."""
        key = np.array(list(blueprint.OUTCOMES.values()), dtype=np.uint32)
        shades = np.concatenate([part for each in drawings for part in (each.colors, key)])
        words = [word for each in drawings for word in (*each.labels, *blueprint.OUTCOMES)]
        names = pa.array(self._names)
        kind = rr.components.GraphEdgeBatch._ARROW_DATATYPE
        ends = [names.take(pa.array(column)) for column in np.concatenate([each.edges for each in drawings]).T]
        joined = rr.components.GraphEdgeBatch(pa.StructArray.from_arrays(ends, fields=list(kind)))
        nodes = (_COLORS, rr.components.ColorBatch(shades)), (_LABELS, rr.components.TextBatch(words))
        lengths = np.array([len(each.edges) for each in drawings])
        return [*cut(len(drawings), *nodes), rr.ComponentColumn(_EDGES, joined, lengths=lengths)]
