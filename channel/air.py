"""The air between the UAVs: takes the frames of a tick, decides which links carry them, and delivers what survives.

FDMA gives every link a band of its own, so links do not interfere; a frame sent in tick n is delivered in tick
n + max(1, ⌈D_m θ/dt⌉).
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from channel.link import Transmission, transmit
from channel.meter import Meter
from swarm import state
from swarm.clusters import Clusters
from swarm.messages import FrameKind, Frames
from swarm.rounds import delivery_ticks
from swarm.scenario import Scenario
from swarm.seeds import generator, random_state, set_random_state

Indices = NDArray[np.intp]
Cut: TypeAlias = Callable[[Indices, Indices], NDArray[np.bool_]]  # sources (K,), targets (K,) → links that fail


class Air:
    """The emulated radio of one run."""

    def __init__(self, scenario: Scenario) -> None:
        self.meter = Meter(scenario.radio, scenario.uavs)
        self._scenario = scenario
        self._head_of = Clusters(scenario).head_of
        slowest = np.array(scenario.radio.latency_threshold_slots)
        self._next_tick = bool(delivery_ticks(scenario, slowest) == 1)  # whatever arrives does so then
        self._draw = generator(scenario.seed, "radio")
        self._in_flight: defaultdict[int, list[Frames]] = defaultdict(list)

    def send(
        self, tick: int, frames: Iterable[Frames], states: state.States, cut: Cut | None = None
    ) -> NDArray[np.int32]:
        """Transmits the frames of one tick, each kind in turn, sources ascending, targets ascending.

        Args:
            frames: at most one batch of a kind, sources ascending. states: (N, 4), where the UAVs are.
            cut: says which links cannot get through, whatever the fading; they spend all their slots.

        Returns:
            The links used, (K, 5): [tick, source, target, kind, slots], slots negative where in outage.
        """
        records = [self._send(tick, batch, states, cut) for batch in sorted(frames, key=lambda batch: batch.kind)]
        return np.concatenate(records) if records else np.zeros((0, 5), dtype=np.int32)

    def due(self, tick: int) -> list[Frames]:
        """Frames delivered in this tick, oldest first; each with the links it arrived on."""
        return self._in_flight.pop(tick, [])

    def snapshot(self) -> dict[str, Any]:
        """All that is on the air and on the bill, for `restore`."""
        return {
            "draw": random_state(self._draw),
            "in_flight": [
                [due, int(f.kind), f.round, f.source, f.payload, f.links]
                for due, batches in sorted(self._in_flight.items())
                for f in batches
            ],
            "meter": self.meter.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on where a snapshot was taken."""
        set_random_state(self._draw, snapshot["draw"])
        self._in_flight.clear()
        for due, kind, number, source, payload, links in snapshot["in_flight"]:
            self._in_flight[due].append(Frames(FrameKind(kind), number, source, payload, links))
        self.meter.restore(snapshot["meter"])

    def _send(self, tick: int, batch: Frames, states: state.States, cut: Cut | None) -> NDArray[np.int32]:
        radio = self._scenario.radio
        sources = batch.source.astype(np.intp)
        links = self._links(batch.kind, sources, states)
        by_radio = sources[links[:, 0]] != links[:, 1]  # heads hear themselves, the leader rides on UAV h
        row, target = links[by_radio].T
        source = sources[row]
        distance = self._distance(states, source, target)
        bits = 8 * batch.payload.itemsize * batch.payload.shape[1]
        sent = transmit(radio, self._draw, distance, bits)
        if cut is not None:
            failed = cut(source, target)
            spent = np.where(failed, radio.latency_threshold_slots, sent.slots)
            sent = Transmission(spent, sent.delivered & ~failed)
        paying = sources
        if batch.kind in (FrameKind.UPLOAD, FrameKind.RELAY):  # a link each, so who needs no radio pays nothing
            paying, row = source, np.arange(len(source))
        self.meter.count(batch.kind, bits, paying, np.stack([row, target], axis=-1), distance, sent)

        through = np.ones(len(links), dtype=bool)
        through[by_radio] = sent.delivered
        if self._next_tick:
            self._deliver(tick + 1, batch, links[through])
        else:
            arrival = np.full(len(links), tick + 1)
            arrival[by_radio] = tick + delivery_ticks(self._scenario, sent.slots)
            for due in np.unique(arrival[through]).tolist():
                self._deliver(due, batch, links[through & (arrival == due)])
        record = np.empty((len(source), 5), dtype=np.int32)
        record[:, 0], record[:, 1], record[:, 2], record[:, 3] = tick, source, target, batch.kind
        record[:, 4] = np.where(sent.delivered, sent.slots, -sent.slots)
        return record

    def _deliver(self, tick: int, batch: Frames, links: Indices) -> None:
        """The frames of a batch arrive over these links in a tick to come."""
        if len(links):
            arrived = Frames(batch.kind, batch.round, batch.source, batch.payload, links.astype(np.int32))
            self._in_flight[tick].append(arrived)

    def _distance(self, states: state.States, source: Indices, target: Indices) -> NDArray[np.float64]:
        """Of links, `(K,)`, m; not measured where no length makes a difference."""
        if not self._scenario.radio.path_loss_exponent:
            return np.ones(len(source))
        difference = states[source, state.POSITION] - states[target, state.POSITION]
        return np.sqrt((difference * difference).sum(axis=-1))

    def _links(self, kind: FrameKind, sources: Indices, states: state.States) -> Indices:
        """[row of sources, receiving UAV] of every link a kind uses, `(K, 2)`."""
        leader = self._scenario.federation.leader
        rows = np.arange(len(sources))
        if kind == FrameKind.UPLOAD:
            return np.stack([rows, self._head_of[sources]], axis=-1)
        if kind == FrameKind.RELAY:
            return np.stack([rows, np.full(len(sources), leader)], axis=-1)
        everyone = np.arange(self._scenario.uavs)
        if kind == FrameKind.GLOBAL:
            wanted = np.ones((len(sources), len(everyone)), dtype=bool)
        else:
            here = states[sources][:, None, state.POSITION] - states[None, :, state.POSITION]
            wanted = (here * here).sum(axis=-1) <= self._scenario.radio.range_m**2
            wanted &= sources[:, None] != everyone[None, :]
        return np.argwhere(wanted)
