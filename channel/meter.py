"""The links that transmissions use, and the meter of their cost: bits, deliveries, outages and airtime."""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, field
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.group_bills import GroupBills
from meanflock.swarm.scenario import Radio
from meanflock.swarm.state import Mask, distinct
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import FrameKind, LinkColumn

Indices = NDArray[np.intp]
TRAFFIC = {
    FrameKind.UPLOAD: "uplink",
    FrameKind.RELAY: "relay",
    FrameKind.GLOBAL: "broadcast",
    FrameKind.STATE: "state",
}


@dataclass(frozen=True, slots=True)
class Links:
    """The L links of a batch, K of them by radio, sorted by source, then by target. The arrays are never written to.

    ends: (L, 2) int32 [row of the batch, receiving UAV], as frames carry them. by_radio: (L,) bool; false if a UAV
    sends to itself. source, target: (K,) nodes at the ends of the links by radio. pair: (K,), source · (N + B) +
    target. senders: (T,) node of each transmission on the bill. first: index of the first link by radio of each
    transmission that has any. record: (J, 7) int32 of each pair of nodes, with the columns of `LinkColumn`, of which
    source, target and kind are set. message: (K,), the place of each link in it; None: its own, J = K. Several rows of
    one UAV, the fragments of its model, are one message. is_unicast: each link is a transmission of its own.
    """

    ends: NDArray[np.int32]
    by_radio: NDArray[np.bool_]
    source: Indices
    target: Indices
    pair: Indices
    senders: Indices
    first: Indices
    record: NDArray[np.int32]
    message: Indices | None
    is_unicast: bool

    @classmethod
    def between(
        cls, kind: FrameKind, sources: Indices, row: Indices, target: Indices, nodes: int, is_unicast: bool = False
    ) -> "Links":
        """Links from `sources[row]` to `target`, (L,) each, rows ascending; `nodes`: N + B. `is_unicast`: each link
        is a transmission of its own, so a source that is its own target transmits nothing."""
        ends = np.empty((len(row), 2), dtype=np.int32)
        ends[:, 0] = row
        ends[:, 1] = target
        source = sources.take(row)
        by_radio = source != target
        if not by_radio.all():
            row, source, target = row[by_radio], source[by_radio], target[by_radio]
        record = np.zeros((len(source), len(LinkColumn)), dtype=np.int32)
        record[:, LinkColumn.SOURCE] = source
        record[:, LinkColumn.TARGET] = target
        record[:, LinkColumn.KIND] = kind
        if is_unicast:
            senders, first = source, np.arange(len(source))
        else:
            begins = np.ones(len(row), dtype=bool)
            np.not_equal(row[1:], row[:-1], out=begins[1:])
            senders, first = sources, begins.nonzero()[0]
        pair = source * nodes + target
        message = None
        if (sources[1:] == sources[:-1]).any():
            _, at, message = np.unique(pair, return_index=True, return_inverse=True)
            record = record[at]
        return cls(ends, by_radio, source, target, pair, senders, first, record, message, is_unicast)


@dataclass
class Used:
    """The K links that were used so far, ascending: much fewer than N² where all talk to one.

    pair: (K,), source · (N + B) + target. sent, outages: (K,).
    """

    pair: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    sent: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    outages: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, dtype=np.int32))

    def rows(self, pairs: Indices) -> Indices:
        """The row of each of `pairs`; those that have none yet get one, so rows found earlier no longer hold."""
        rows = self.pair.searchsorted(pairs)
        listed = rows < len(self.pair)
        if len(self.pair):
            listed &= self.pair.take(rows, mode="clip") == pairs
        if np.count_nonzero(listed) == len(pairs):
            return rows
        before, self.pair = self.pair, distinct(np.concatenate([self.pair, pairs]))
        old_rows = self.pair.searchsorted(before)
        for name in ("sent", "outages"):
            counts = np.zeros(len(self.pair), dtype=np.int32)
            counts[old_rows] = getattr(self, name)
            setattr(self, name, counts)
        return self.pair.searchsorted(pairs)


@dataclass
class Traffic:
    """Totals of one kind since take-off."""

    transmissions: int = 0
    payload_bits: int = 0  # once a transmission, as the paper counts; scales included
    wire_bytes: int = 0  # encoded frames on the bus, on their way to the radio
    sent: int = 0  # link copies
    delivered: int = 0
    outages: int = 0
    slots: int = 0  # on all links, lost messages included
    delivered_slots: int = 0
    airtime_s: float = 0.0  # a transmission lasts until its last link is served or given up
    expected_outages: float | None = 0.0  # closed form, summed over the links used; None if the channel has none
    expected_delivered_slots: float | None = 0.0


class Meter(Stateful):
    """The counters of a run, by kind of traffic and by link."""

    stored = ("totals", "table", "marked", "loads", "groups")

    def __init__(self, radio: Radio, uavs: int, stations: int = 0, groups: Sequence[int] = ()) -> None:
        """`groups`: number of UAVs of each group of the flight, in their order."""
        self.groups = GroupBills(groups, stations) if groups else None
        self.traffic = {kind: Traffic() for kind in FrameKind}
        self.radio, self.uavs, self.nodes = radio, uavs, uavs + stations
        self._used = Used()
        self._last: Links | None = None  # last batch; its counts are added to those of the links later
        self._rows: Indices = np.zeros(0, dtype=np.intp)  # of its links in `_used`
        self._times = 0
        self._slots: NDArray[np.int64] = np.zeros(0, dtype=np.int64)  # (K,) on its links, summed over its times
        self._lasts: NDArray[np.int64] = np.zeros(0, dtype=np.int64)  # (T,) of its transmissions
        self._listening: Mask = np.ones(self.nodes, dtype=bool)
        self._loads = np.zeros((3, self.nodes), dtype=np.int64)
        self.marked: list[int] | None = None  # payload bits by kind, as `mark` found them
        self._figures: tuple[float, ...] | None = None  # cached until a batch is counted

    def count(
        self,
        kind: FrameKind,
        payload_bits: int,
        links: Links,
        slots: NDArray[np.int64],
        delivered: NDArray[np.bool_],
        expected: tuple[float, float] | None,
        wasted: NDArray[np.int64] | int = 0,
    ) -> None:
        """Adds one batch of transmissions of a kind over K links by radio.

        Args:
            payload_bits: of one transmission. slots: (K,). delivered: (K,). expected: closed forms of the outages and
                delivered slots of all these links; None if the channel has none. wasted: (T,) slots that each
                transmission spent in collisions before.
        """
        self._figures = None
        total = self.traffic[kind]
        total.transmissions += len(links.senders)
        total.payload_bits += payload_bits * len(links.senders)
        if self.groups is not None:
            self.groups.add(kind, payload_bits, links.senders)
        if not (copies := len(links.pair)):
            return
        arrived, spent = int(np.count_nonzero(delivered)), int(np.add.reduce(slots))
        total.sent += copies
        total.delivered += arrived
        total.outages += copies - arrived
        total.slots += spent
        total.delivered_slots += spent if arrived == copies else int(slots[delivered].sum())
        lasts: NDArray[np.int64] = np.add(np.maximum.reduceat(slots, links.first), wasted, dtype=np.int64)
        total.airtime_s += int(np.add.reduce(lasts)) * self.radio.coherence_time_s
        outages, latency = (None, None) if expected is None else expected
        total.expected_outages = _sum(total.expected_outages, outages)
        total.expected_delivered_slots = _sum(total.expected_delivered_slots, latency)
        if links is not self._last:
            self._enter()
            self._last = links
            self._rows = self._used.rows(links.pair)
            self._slots, self._lasts = np.zeros_like(slots), np.zeros_like(lasts)
        self._times += 1
        self._slots += slots
        self._lasts += lasts
        if arrived < copies:
            _add(self._used.outages, links, self._rows[~delivered], 1)

    def initial(self, payload_bits: int) -> None:
        """Counts the mission plan: one state broadcast of each UAV before take-off, never in outage."""
        self._figures = None
        total = self.traffic[FrameKind.STATE]
        total.transmissions += self.uavs
        total.payload_bits += payload_bits * self.uavs
        if self.groups is not None:
            self.groups.add(FrameKind.STATE, payload_bits, np.arange(self.uavs))

    def wire(self, kind: FrameKind, bytes_: int) -> None:
        """Adds the encoded size of frames."""
        self.traffic[kind].wire_bytes += bytes_

    def bits(self) -> list[int]:
        """Payload bits so far by kind of traffic, as in `TRAFFIC`."""
        return [self.traffic[kind].payload_bits for kind in TRAFFIC]

    def mark(self, arrived: Mask) -> None:
        """Stores the payload bits so far in `marked`, and those of the groups of UAVs that have just arrived, (N,); a
        later call replaces them.
        """
        self.marked = self.bits()
        if self.groups is not None:
            self.groups.mark(arrived.nonzero()[0])

    def links(self) -> list[list[int]]:
        """Rows [source, target, sent, outages] of all links that were used, ascending."""
        table: list[list[int]] = self.table.tolist()
        return table

    def total(self, name: str) -> float:
        """Sum of one field of `Traffic` over all kinds."""
        return sum(getattr(of_kind, name) for of_kind in self.traffic.values())

    def all_kinds(self) -> Traffic:
        """Totals of all kinds; a field is None if it is None for one kind."""
        each = map(astuple, self.traffic.values())
        return Traffic(*(reduce(_sum, fields) for fields in zip(*each, strict=True)))

    def figures(self) -> tuple[float, ...]:
        """Payload bits by kind, in the order of `TRAFFIC`; then deliveries, outages and airtime of all kinds."""
        if self._figures is None:
            self._figures = *self.bits(), self.total("delivered"), self.total("outages"), self.total("airtime_s")
        return self._figures

    @property
    def totals(self) -> list[dict[str, Any]]:
        """Totals of each kind of frame."""
        return [asdict(self.traffic[kind]) for kind in FrameKind]

    @totals.setter
    def totals(self, stored: list[dict[str, Any]]) -> None:
        self._figures = None
        self.traffic = {kind: Traffic(**totals) for kind, totals in zip(FrameKind, stored, strict=True)}

    @property
    def table(self) -> NDArray[np.int32]:
        """`links` as an array `(K, 4)`."""
        self._enter()
        used = self._used
        return np.stack([*np.divmod(used.pair, self.nodes), used.sent, used.outages], axis=-1).astype(np.int32)

    @table.setter
    def table(self, stored: NDArray[np.int32]) -> None:
        self._last, self._times = None, 0
        source, target, sent, outages = stored.T
        self._used = Used(source.astype(np.intp) * self.nodes + target, sent.astype(np.int32), outages.astype(np.int32))

    def listen(self, present: Mask) -> None:
        """From now on the nodes that are `present` (N + B,) receive, and no others."""
        if present is not self._listening and (present != self._listening).any():
            self._enter()
        self._listening = present

    @property
    def loads(self) -> NDArray[np.int64]:
        """(3, N + B), slots of each node: of its transmissions; of its links; and of what comes while it listens."""
        self._enter()
        return self._loads

    @loads.setter
    def loads(self, stored: NDArray[np.int64]) -> None:
        self._loads = stored.astype(np.int64)

    def _enter(self) -> None:
        if (links := self._last) is not None:
            _add(self._used.sent, links, self._rows, self._times)
            sources = links.source[links.first]
            for load, nodes, slots in (
                (self._loads[0], sources, self._lasts),
                (self._loads[1], links.source, self._slots),
                (self._loads[2], links.target, self._slots * self._listening[links.target]),
            ):
                load += np.bincount(nodes, weights=slots, minlength=self.nodes).astype(np.int64)
            self._times, self._slots, self._lasts = 0, np.zeros_like(self._slots), np.zeros_like(self._lasts)


def _add(counts: NDArray[np.int32], links: Links, rows: Indices, times: int) -> None:
    """Adds to the counts of some rows, which may come several times where models are cut."""
    if links.message is not None:
        counts += (times * np.bincount(rows, minlength=len(counts))).astype(counts.dtype)
    else:
        counts[rows] += times


def _sum(so_far: Any, more: Any) -> Any:
    return None if so_far is None or more is None else so_far + more
