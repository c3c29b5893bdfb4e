"""The air between the UAVs: takes the frames of a tick, decides which links carry them, and delivers what survives.

FDMA gives every link a band of its own, so links do not interfere; a frame sent in tick n is delivered in tick
n + max(1, ⌈D_m θ/dt⌉).
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from channel import kernel
from channel.account import account
from channel.fading import Fading
from channel.link import Transmission, transmit
from channel.links import Links
from channel.meter import Meter
from swarm import state
from swarm.clusters import Clusters
from swarm.messages import FrameKind, Frames
from swarm.rounds import delivery_ticks
from swarm.scenario import Scenario
from swarm.seeds import generator

Indices = NDArray[np.intp]
NO_LINKS = np.zeros((0, 5), dtype=np.int32)  # of a tick in which nobody sends; shared, not to be written to
Cut: TypeAlias = Callable[[Indices, Indices], NDArray[np.bool_]]  # sources (K,), targets (K,) → links that fail


class Air:
    """The emulated radio of one run."""

    def __init__(self, scenario: Scenario) -> None:
        self.meter = Meter(scenario.radio, scenario.uavs)
        self._scenario = scenario
        self._head_of = Clusters(scenario).head_of
        slowest = np.array(scenario.radio.latency_threshold_slots)
        self._next_tick = bool(delivery_ticks(scenario, slowest) == 1)  # whatever arrives does so then
        self._fading = Fading(generator(scenario.seed, "radio"), scenario.radio)
        self._range_squared = scenario.radio.range_m**2
        self._everyone = np.arange(scenario.uavs).tobytes()
        self._spoken = b""  # who sent to whom in the last broadcast, nothing where everyone to everyone;
        self._links_of_spoken: Links | None = None
        self._of_model: tuple[bytes, Links] | None = None  # the same of the last global model: always one UAV to all
        self._in_flight: defaultdict[int, list[Frames]] = defaultdict(list)

    def send(
        self, tick: int, frames: Sequence[Frames], states: state.States, cut: Cut | None = None
    ) -> NDArray[np.int32]:
        """Transmits the frames of one tick, each kind in turn, sources ascending, targets ascending.

        Args:
            frames: at most one batch of a kind, sources ascending. states: (N, 4), where the UAVs are.
            cut: says which links cannot get through, whatever the fading; they spend all their slots.

        Returns:
            The links used, (K, 5): [tick, source, target, kind, slots], slots negative where in outage.
        """
        if not frames:
            return NO_LINKS
        records = [self._send(tick, batch, states, cut) for batch in sorted(frames, key=lambda batch: batch.kind)]
        return records[0] if len(records) == 1 else np.concatenate(records)

    def due(self, tick: int) -> list[Frames]:
        """Frames delivered in this tick, oldest first; each with the links it arrived on."""
        return self._in_flight.pop(tick, [])

    def snapshot(self) -> dict[str, Any]:
        """All that is on the air and on the bill, for `restore`."""
        return {
            "draw": self._fading.snapshot(),
            "in_flight": [
                [due, int(f.kind), f.round, f.source, f.payload, f.links]
                for due, batches in sorted(self._in_flight.items())
                for f in batches
            ],
            "meter": self.meter.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on where a snapshot was taken."""
        self._fading.restore(snapshot["draw"])
        self._in_flight.clear()
        for due, kind, number, source, payload, links in snapshot["in_flight"]:
            self._in_flight[due].append(Frames(FrameKind(kind), number, source, payload, links))
        self.meter.restore(snapshot["meter"])

    def _send(self, tick: int, batch: Frames, states: state.States, cut: Cut | None) -> NDArray[np.int32]:
        radio = self._scenario.radio
        links = self._links(batch.kind, batch.source.astype(np.intp), states)
        distance = self._distance(states, links)
        bits = 8 * batch.payload.itemsize * batch.payload.shape[1]
        sent = transmit(radio, self._fading, distance, bits)
        if cut is not None:
            failed = cut(links.source, links.target)
            spent = np.where(failed, radio.latency_threshold_slots, sent.slots)
            sent = Transmission(spent, sent.missing + failed)
        came_to = account(tick, links, sent)
        self.meter.count(batch.kind, bits, links, distance, came_to)

        ends = links.ends
        if not self._next_tick or came_to.outages:
            through = np.ones(len(ends), dtype=bool)
            through[links.by_radio] = sent.delivered
        if not self._next_tick:
            arrival = np.full(len(ends), tick + 1)
            arrival[links.by_radio] = tick + delivery_ticks(self._scenario, sent.slots)
            for due in np.unique(arrival[through]).tolist():
                self._deliver(due, batch, ends[through & (arrival == due)])
        else:
            self._deliver(tick + 1, batch, ends.compress(through, axis=0) if came_to.outages else ends)
        return came_to.record

    def _deliver(self, tick: int, batch: Frames, ends: NDArray[np.int32]) -> None:
        """The frames of a batch arrive over these links in a tick to come."""
        if len(ends):
            self._in_flight[tick].append(Frames(batch.kind, batch.round, batch.source, batch.payload, ends))

    def _distance(self, states: state.States, links: Links) -> NDArray[np.float64]:
        """Of links by radio, `(K,)`, m; not measured where no length makes a difference."""
        if not self._scenario.radio.path_loss_exponent:
            return links.alike
        difference = states[links.source, state.POSITION] - states[links.target, state.POSITION]
        return np.sqrt((difference * difference).sum(axis=-1))

    def _links(self, kind: FrameKind, sources: Indices, states: state.States) -> Links:
        """Every link a kind uses."""
        if kind == FrameKind.STATE:
            return self._in_range(sources, states)
        leader, uavs = self._scenario.federation.leader, self._scenario.uavs
        rows = np.arange(len(sources))
        if kind == FrameKind.UPLOAD:
            return Links.of(kind, sources, rows, self._head_of[sources], uavs)
        if kind == FrameKind.RELAY:
            return Links.of(kind, sources, rows, np.full(len(sources), leader), uavs)
        if self._of_model is None or self._of_model[0] != sources.tobytes():
            to_all = Links.of(kind, sources, rows.repeat(uavs), np.tile(np.arange(uavs), len(sources)), uavs)
            self._of_model = sources.tobytes(), to_all
        return self._of_model[1]

    def _in_range(self, sources: Indices, states: state.States) -> Links:
        """From sources to all others they reach: mostly the same as a tick ago, and everyone to everyone."""
        to_all = sources.tobytes() == self._everyone and self._are_together(states)
        if to_all and not self._spoken and self._links_of_spoken is not None:
            return self._links_of_spoken
        here = states if len(sources) == len(states) else states[sources]
        along = here[:, state.X, None] - states[:, state.X]
        across = here[:, state.Y, None] - states[:, state.Y]
        along *= along
        across *= across
        along += across
        wanted = along <= self._range_squared
        wanted[np.arange(len(sources)), sources] = False
        spoken = b"" if to_all else sources.tobytes() + wanted.tobytes()
        if self._links_of_spoken is None or spoken != self._spoken:
            row, target = wanted.nonzero()
            self._spoken = spoken
            self._links_of_spoken = Links.of(FrameKind.STATE, sources, row, target, self._scenario.uavs)
        return self._links_of_spoken

    def _are_together(self, states: state.States) -> bool:
        """Whether no two UAVs can be out of range: the corners of a box around all of them are not.

        Rounding keeps order, so a distance within the box comes out no longer than its diagonal.
        """
        if kernel.is_compiled():
            return kernel.within(states, self._range_squared)
        here = states[:, state.POSITION]
        along, across = (np.maximum.reduce(here) - np.minimum.reduce(here)).tolist()
        return bool(along * along + across * across <= self._range_squared)
