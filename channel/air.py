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
        on_board = links[:, 1] == sources[links[:, 0]]  # heads hear themselves, the leader rides on UAV h
        by_radio = links[~on_board]
        difference = states[sources[by_radio[:, 0]], state.POSITION] - states[by_radio[:, 1], state.POSITION]
        distance = np.sqrt((difference * difference).sum(axis=-1))
        bits = 8 * batch.payload.itemsize * batch.payload.shape[1]
        sent = transmit(radio, self._draw, distance, bits)
        if cut is not None:
            failed = cut(sources[by_radio[:, 0]], by_radio[:, 1])
            spent = np.where(failed, radio.latency_threshold_slots, sent.slots)
            sent = Transmission(spent, sent.delivered & ~failed)
        to_one = batch.kind in (FrameKind.UPLOAD, FrameKind.RELAY)  # a link each, so who needs no radio pays nothing
        paying = sources[by_radio[:, 0]] if to_one else sources
        rank = np.searchsorted(paying, sources[by_radio[:, 0]])
        self.meter.count(batch.kind, bits, paying, np.stack([rank, by_radio[:, 1]], axis=-1), distance, sent)

        arrival = np.full(len(links), tick + 1)
        arrival[~on_board] = tick + delivery_ticks(self._scenario, sent.slots)
        through = np.ones(len(links), dtype=bool)
        through[~on_board] = sent.delivered
        # Most often everything arrives in one tick, and finding that out is cheaper than sorting.
        ticks = arrival[through]
        for due in np.unique(ticks) if len(ticks) and ticks.min() != ticks.max() else ticks[:1]:
            arrived = links[through & (arrival == due)].astype(np.int32)
            self._in_flight[int(due)].append(Frames(batch.kind, batch.round, batch.source, batch.payload, arrived))
        slots = np.where(sent.delivered, sent.slots, -sent.slots)
        return np.stack(
            [
                np.full(len(by_radio), tick),
                sources[by_radio[:, 0]],
                by_radio[:, 1],
                np.full(len(by_radio), batch.kind),
                slots,
            ],
            axis=-1,
        ).astype(np.int32)

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
