"""Medium between the UAVs: finds the links of the frames of a tick, and delivers the frames that get through.

FDMA gives every link a band of its own, so links do not interfere. A frame sent in tick n is delivered in tick
n + max(1, ⌈D_m θ/dt⌉). With TDMA a transmission waits until the one before it in its band is over, when its last link
is served or given up, and all else is the same. With CSMA the senders of a batch contend for one band, and collide. The
channel decides latency and loss on each link.
"""

import math
from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.base import (
    MOST_SLOTS,
    Channel,
    Fate,
    Memory,
    Message,
    NoiseSources,
    carried,
    failed,
    in_space,
    sums,
)
from meanflock.channel.contention import contend, share_collided
from meanflock.channel.meter import Links, Meter
from meanflock.channel.serving import Serving
from meanflock.federation.plan import Plan
from meanflock.swarm import plugins, state
from meanflock.swarm.counts import count_of
from meanflock.swarm.declared import most_memory
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.plugins.guard import check_array, check_memory
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator
from meanflock.swarm.state import Floats, Mask, contains
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import FrameKind, Frames, LinkColumn, frames_of

Indices = NDArray[np.intp]
NO_LINKS = np.zeros((0, len(LinkColumn)), dtype=np.int32)  # of a tick without frames; shared, never written to
Expected: TypeAlias = tuple[float, float] | None  # closed forms of outages and slots; None: unknown
Cut: TypeAlias = Callable[[Indices, Indices], NDArray[np.bool_]]  # sources (K,), targets (K,) → links that fail


class Medium(Stateful):
    """The emulated radio of one run."""

    stored = ("draw", "memory", "under_way", "meter", "free", "backoffs", "serving")

    def __init__(self, plan: Plan) -> None:
        """Raises BadInput if the channel is not installed, its options do not fit, or its `init` fails."""
        scenario, hops = plan.scenario, plan.hops
        radio = scenario.radio
        groups = [group.count for group in scenario.groups]
        self.meter = Meter(radio, scenario.uavs, len(scenario.stations), groups)
        self._scenario = scenario
        self._channel: Channel = plugins.create("channel", radio.model, radio.options, scenario)
        self.memory = _begun(self._channel, radio.model, scenario)
        self.draw = generator(scenario.seed, "radio")
        self.backoffs = generator(scenario.seed, "access")
        self._bands = {hop.label: hop.bands for hop in hops}
        self._bands[FrameKind.STATE] = hops[0].bands if hops else None
        bands = [int(np.max(band)) for band in self._bands.values() if band is not None]
        self.free = np.zeros(1 + max(bands, default=0))  # slot since take-off from which each band is free
        self.serving = Serving(scenario)
        self._hops = {hop.label: hop for hop in hops}
        self._seat = plan.seat
        self._to_stations = _to_stations(scenario) if any(hop.by_station for hop in hops) else None
        slots = range(1, MOST_SLOTS + 1)
        self._soon = bisect_right(slots, 1, key=lambda spent: int(scenario.delivery_ticks(np.array(spent))))  # a tick
        self._reach = {hop.label: hop.range_m for hop in hops if hop.range_m is not None}
        self._reach[FrameKind.STATE] = radio.range_m  # m; a broadcast addresses the UAVs within it
        self._models_reach = math.inf if scenario.federation.range_m is None else scenario.federation.range_m
        self._hears = {  # (N,), where not all UAVs take part in rounds
            hop.label: contains(hop.receivers, np.arange(scenario.uavs)) for hop in hops if hop.receivers is not None
        }
        self._groups = len(plan.groups)
        # By kind and number of a batch: its last senders, the UAVs that they reached or their targets (None: all), and
        # the links. The next tick mostly uses the same ones; fragments, those of the last round, which has two turns.
        self._used: dict[tuple[FrameKind, int], deque[tuple[bytes, bytes | None, Links]]] = {}
        self._in_flight: defaultdict[int, list[Frames]] = defaultdict(list)

    def send(
        self,
        tick: int,
        frames: Sequence[Frames],
        states: state.States,
        cut: Cut | None = None,
        noise: NoiseSources | None = None,
    ) -> NDArray[np.int32]:
        """Transmits the frames of one tick, by kind and round, sources ascending, targets ascending.

        Args:
            frames: at most one batch of a kind and round, sources ascending; of states, `round` numbers the
                broadcasts of a tick. Payloads are rows of any dtype and width. states: (N, 4), where the UAVs are.
            cut: says which links cannot get through, whatever the fading; they spend all their slots.
            noise: (J, 5), jammers that send noise.

        Returns:
            The links used, (K, 7), with the columns of `LinkColumn`.
        """
        if not frames:
            return NO_LINKS
        ordered = sorted(frames, key=lambda batch: (batch.kind, batch.round))
        records = [self._send(tick, batch, states, cut, noise) for batch in ordered]
        return records[0] if len(records) == 1 else np.concatenate(records)

    def serve(self, tick: int, states: state.States, present: Mask) -> None:
        """Chooses the station of each UAV, if the topology lets stations serve UAVs.

        Args:
            states: (N, 4), where the UAVs are. present: (N + B,), nodes that are neither lost nor paused; no other
                listens from now on.
        """
        self.meter.listen(present)
        if (links := self._to_stations) is None:
            return
        uavs = self._scenario.uavs
        try:
            signal_db = self._channel.signal_db(self._message(tick, FrameKind.UPLOAD, 1, links, states))
            check_array("`signal_db`", signal_db, (len(links.pair),), np.float64)
        except FAILURES as error:
            raise failed(self._scenario.radio.model, error) from error
        self.serving.update(signal_db.reshape(uavs, -1), present[uavs:], present[:uavs])

    def acknowledge(
        self,
        tick: int,
        states: state.States,
        cut: Cut | None,
        noise: NoiseSources | None,
        kind: FrameKind,
        bits: int,
        source: Indices,
        target: Indices,
    ) -> NDArray[np.bool_]:
        """Transmits messages of `bits` bits over links between two UAVs, (K,), sources ascending, which arrive in this
        tick; they are billed under a kind.

        Returns:
            The mask (K,) of those that arrive.
        """
        links = Links.between(kind, source, np.arange(len(source)), target, self._scenario.nodes, is_unicast=True)
        fate, expected = self._carried(self._message(tick, kind, bits, links, states, noise), self._models_reach)
        if cut is not None:
            fate = self._failed(cut(links.source, links.target), fate)
        fate, expected = self._shared(tick, kind, links, fate, expected)
        self.meter.count(kind, bits, links, fate.slots, fate.delivered, expected, fate.wasted)
        return fate.delivered

    @property
    def clamped(self) -> int:
        """Number of links so far whose places were beyond what the channel's sources hold for."""
        try:
            return count_of("`clamped` returns", self._channel.clamped(self.memory), 0)
        except FAILURES as error:
            raise failed(self._scenario.radio.model, error) from error

    def due(self, tick: int) -> list[Frames]:
        """Frames delivered in this tick, oldest first; each with the links it arrived on."""
        return self._in_flight.pop(tick, [])

    @property
    def under_way(self) -> list[tuple[int, Any]]:
        """The frames that were not delivered yet, each batch after the tick in which it will be."""
        return [(due, batch) for due, batches in sorted(self._in_flight.items()) for batch in batches]

    @under_way.setter
    def under_way(self, stored: list[tuple[int, Any]]) -> None:
        self._in_flight.clear()
        for due, fields in stored:
            self._in_flight[due].append(frames_of(fields))

    def _send(
        self, tick: int, batch: Frames, states: state.States, cut: Cut | None, noise: NoiseSources | None
    ) -> NDArray[np.int32]:
        links = self._links(batch, states)
        bits = 8 * batch.payload.itemsize * batch.payload.shape[1]
        reach = math.inf if batch.kind == FrameKind.STATE else self._models_reach
        fate, expected = self._carried(self._message(tick, batch.kind, bits, links, states, noise), reach)
        if cut is not None:
            fate = self._failed(cut(links.source, links.target), fate)
        fate, expected = self._shared(tick, batch.kind, links, fate, expected)
        slots, delivered = fate.slots, fate.delivered
        self.meter.count(batch.kind, bits, links, slots, delivered, expected, fate.wasted)

        ends, spent = links.ends, None
        all_arrive = bool(np.logical_and.reduce(delivered))
        if batch.kind != FrameKind.STATE:  # an aggregation rule may weigh models by their slots
            spent = np.zeros(len(ends), dtype=np.int32)
            spent[links.by_radio] = slots
        if not all_arrive:
            through = np.ones(len(ends), dtype=bool)
            through[links.by_radio] = delivered
            ends, spent = ends.compress(through, axis=0), None if spent is None else spent[through]
        taken = slots + fate.waited
        if np.maximum.reduce(taken, initial=0) <= self._soon:
            self._deliver(tick + 1, batch, ends, spent)
            return _record(tick, links, fate)
        arrival = np.full(len(links.ends), tick + 1)
        arrival[links.by_radio] = tick + self._scenario.delivery_ticks(taken)
        if not all_arrive:
            arrival = arrival[through]
        for due in np.unique(arrival).tolist():
            now = arrival == due
            self._deliver(due, batch, ends[now], None if spent is None else spent[now])
        return _record(tick, links, fate)

    def _carried(self, message: Message, reach: float) -> tuple[Fate, Expected]:
        """Send a message; on links longer than `reach`, in m, it fails.

        Returns:
            Its outcome, and closed forms of outages and slots.
        """
        count = len(message.source)
        if not count:
            return Fate(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool), np.zeros(0, dtype=np.int64)), (0.0, 0.0)
        try:
            for array in self.memory.values():
                array.flags.writeable = False
            answer = self._channel.carry(dict(self.memory), message, self.draw)
            self.memory, fate = carried(answer, self.memory, count)
            within = count
            if reach < math.inf and (beyond := message.distance_m > reach).any():
                fate = self._failed(beyond, fate)
                message = _only(message, ~beyond)
                within = len(message.distance_m)
            expected = sums(self._channel, message, self.memory)
        except FAILURES as error:
            raise failed(self._scenario.radio.model, error) from error
        if expected is not None:
            expected = expected[0] + (count - within), expected[1]
        return fate, expected

    def _message(
        self,
        tick: int,
        kind: FrameKind,
        bits: int,
        links: Links,
        states: state.States,
        noise: NoiseSources | None = None,
    ) -> Message:
        """The message over some links, with the UAVs at `states` (N, 2d)."""
        here = state.position(states)
        place = in_space(here, self._scenario)
        axes: Sequence[Floats] = state.parts(here)
        if self._scenario.stations:
            here, axes = place[:, : self._scenario.dimensions], list(place.T)
        distance = _distance(axes, links)
        name = kind.name.lower()
        return Message(tick, bits, links.source, links.target, distance, here, name, place, links.first, noise)

    def _shared(
        self, tick: int, kind: FrameKind, links: Links, fate: Fate, expected: Expected
    ) -> tuple[Fate, Expected]:
        """Outcome and closed forms of a message whose transmissions share a band; one lasts as its slowest link."""
        radio = self._scenario.radio
        if radio.access == "fdma" or not len(links.first):
            return fate, expected
        lasts, copies = np.maximum.reduceat(fate.slots, links.first), np.diff(links.first, append=len(fate.slots))
        now = math.ceil(tick * self._scenario.dt / radio.coherence_time_s * (1.0 - 1e-9))
        sender = links.source[links.first]
        if radio.access == "tdma":
            begin = self._queued(now, lasts, self._bands[kind], sender)
        else:
            start = max(self.free[0], now)
            found = contend(self.backoffs, sender, lasts, radio.contention_slots, acknowledged=links.is_unicast)
            begin, self.free[0] = start + found.begin, start + found.end
            fate = fate._replace(delivered=fate.delivered & ~found.collided.repeat(copies), wasted=found.wasted)
            if expected is not None and not links.is_unicast:
                _, frames = np.unique(sender, return_counts=True)
                collided = float(share_collided(frames).repeat(frames) @ copies) / len(fate.slots)
                lost, slots = expected
                expected = lost + collided * (len(fate.slots) - lost), slots * (1.0 - collided)
        waits = np.ceil(begin - now).astype(np.int64).repeat(copies)
        return fate._replace(waited=fate.waited + waits), expected

    def _queued(self, now: int, lasts: NDArray[np.int64], bands: Indices | None, sender: Indices) -> Floats:
        """Slots (T,) in which transmissions that last so long begin, one after another in the band of their sender."""
        band = np.zeros(len(sender), dtype=np.intp) if bands is None else bands[sender]
        begin = np.empty(len(sender))
        for each in np.unique(band).tolist():
            own = band == each
            ends = max(self.free[each], now) + np.cumsum(lasts[own])
            begin[own], self.free[each] = ends - lasts[own], ends[-1]
        return begin

    def _failed(self, failed: NDArray[np.bool_], fate: Fate) -> Fate:
        """Outcome of a message with links that `failed` (K,), which deliver nothing and spend all their slots."""
        slots = np.where(failed, self._scenario.radio.latency_threshold_slots, fate.slots)
        return fate._replace(slots=slots, delivered=fate.delivered & ~failed)

    def _deliver(self, tick: int, batch: Frames, ends: NDArray[np.int32], slots: NDArray[np.int32] | None) -> None:
        """Schedule the frames of a batch for delivery over links in a later tick; `slots`: what each link took."""
        if len(ends):
            self._in_flight[tick].append(Frames(batch.kind, batch.round, batch.source, batch.payload, ends, slots))

    def _links(self, batch: Frames, states: state.States) -> Links:
        """The links that a batch uses; those of an earlier tick if sources and targets are the same."""
        kind = batch.kind
        sources = batch.source.astype(np.intp)
        uavs, nodes = self._scenario.uavs, self._scenario.nodes
        senders, mask = sources.tobytes(), None
        is_broadcast = kind in self._reach
        reached = self._in_range(sources, states, self._reach[kind]) if is_broadcast else None
        hears = self._hears.get(kind)
        if is_broadcast and hears is not None:
            reached = (np.arange(uavs) != sources[:, None] if reached is None else reached) & hears
        if reached is not None:
            mask = reached.tobytes()
        hop, targets = self._hops.get(kind), None
        serves = hop is not None and hop.by_station and self._seat(batch.round) >= uavs  # else the leader flies
        if serves:
            mask = self.serving.node.tobytes()
            targets = self.serving.node[sources][:, None] if kind == FrameKind.UPLOAD else None
        elif hop is not None and (targets := hop.targets_of(sources, self._seat(batch.round))) is not None:
            mask = targets.tobytes()
        number, turns = (batch.round, self._groups) if kind == FrameKind.STATE else (0, 2)
        used = self._used.setdefault((kind, number), deque(maxlen=turns))
        for earlier in used:
            if earlier[:2] == (senders, mask):
                return earlier[2]
        rows = np.arange(len(sources))
        if reached is not None:
            row, target = reached.nonzero()
            links = Links.between(kind, sources, row, target, nodes)
        elif targets is not None:
            row = rows.repeat(targets.shape[1])
            links = Links.between(kind, sources, row, targets.ravel(), nodes, is_unicast=True)
        elif is_broadcast:
            target = np.arange(uavs - 1) + (np.arange(uavs - 1) >= sources[:, None])  # all but the source
            links = Links.between(kind, sources, rows.repeat(uavs - 1), target.ravel(), nodes)
        elif serves:
            served = self.serving.node == sources[:, None]
            row, target = (served if hears is None else served & hears).nonzero()
            links = Links.between(kind, sources, row, target, nodes)
        else:
            everyone = np.arange(uavs) if hears is None else np.flatnonzero(hears)
            targets = np.tile(everyone, len(sources))
            links = Links.between(kind, sources, rows.repeat(len(everyone)), targets, nodes)
        used.append((senders, mask, links))
        return links

    def _in_range(self, sources: Indices, states: state.States, reach: float) -> NDArray[np.bool_] | None:
        """Mask (S, N) of the UAVs that each source reaches; None if every UAV reaches every other."""
        if self._are_together(states, reach):
            return None
        apart = [along[sources, None] - along for along in state.parts(state.position(states))]
        reached: NDArray[np.bool_] = state.squared(apart) <= reach * reach
        reached[np.arange(len(sources)), sources] = False
        return reached

    def _are_together(self, states: state.States, reach: float) -> bool:
        """Returns whether the diagonal of the box around all UAVs is at most `reach`, and so any two UAVs' distance.

        Rounding is monotone, so no computed distance within the box exceeds its computed diagonal.
        """
        here = state.position(states)
        sides = (np.maximum.reduce(here) - np.minimum.reduce(here)).tolist()
        return bool(state.squared(sides) <= reach * reach)


def _begun(channel: Channel, name: str, scenario: Scenario) -> Memory:
    """The memory of a channel at take-off; raises BadInput if it is none, or too large for a checkpoint."""
    try:
        memory = channel.init(scenario.nodes)
        check_memory("`init`: memory", memory)
    except FAILURES as error:
        raise BadInput(f"channel {name!r}: {last_line(error)}") from error
    size = sum(array.nbytes for array in memory.values())
    if size > (most := most_memory(scenario.uavs)):
        raise BadInput(
            f"channel {name!r}: a memory of {size / 2**20:.0f} MiB for {scenario.uavs} UAVs; a checkpoint keeps up to "
            f"{most >> 20} MiB: fly fewer UAVs, or let it keep less"
        )
    return memory


def _to_stations(scenario: Scenario) -> Links:
    """The links from all UAVs to all stations."""
    uavs, nodes = scenario.uavs, scenario.nodes
    row, target = np.repeat(np.arange(uavs), nodes - uavs), np.tile(np.arange(uavs, nodes), uavs)
    return Links.between(FrameKind.UPLOAD, np.arange(uavs), row, target, nodes, is_unicast=True)


def _distance(axes: Sequence[Floats], links: Links) -> Floats:
    """Lengths of the links by radio, (K,), m; `axes`: coordinates of all nodes, (N,) or (N + B,) each."""
    source, target = links.source, links.target
    if links.message is not None:  # each pair of nodes once
        source, target = links.record[:, [LinkColumn.SOURCE, LinkColumn.TARGET]].astype(np.intp).T
    squares = []
    for along in axes:
        apart = along[source] - along[target]
        squares.append(np.multiply(apart, apart, out=apart))
    for square in squares[1:]:
        squares[0] += square
    length: Floats = np.sqrt(squares[0], out=squares[0])
    return length if links.message is None else length[links.message]


def _only(message: Message, links: NDArray[np.bool_]) -> Message:
    """The message over some of its links, (K,); a transmission without any link is left out."""
    assert message.first is not None
    begins = np.zeros(len(links), dtype=bool)
    begins[message.first] = True
    transmission = (np.cumsum(begins) - 1)[links]
    first = np.flatnonzero(np.diff(transmission, prepend=-1))
    return message._replace(
        source=message.source[links], target=message.target[links], distance_m=message.distance_m[links], first=first
    )


def _record(tick: int, links: Links, fate: Fate) -> NDArray[np.int32]:
    """The links used, (K, 7), as `Medium.send` returns them; the fragments of a model are one message."""
    record = links.record.copy()
    slots, delivered, waited, _ = fate
    if links.message is not None:
        slots = np.bincount(links.message, weights=slots).astype(np.int64)
        delivered = np.bincount(links.message, weights=delivered) > 0
        longest = np.zeros(len(slots), dtype=np.int64)
        np.maximum.at(longest, links.message, waited)
        waited = longest
    record[:, LinkColumn.TICK] = tick
    record[:, LinkColumn.SLOTS] = slots
    record[:, LinkColumn.DELIVERED] = delivered
    record[:, LinkColumn.WAITED] = waited
    return record
