"""What the radio cost: bits, link copies, deliveries, outages, airtime, by kind of traffic and by link."""

from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from channel import theory
from channel.account import Account
from channel.links import Links
from swarm.messages import FrameKind
from swarm.scenario import Radio

TRAFFIC = {
    FrameKind.UPLOAD: "uplink",
    FrameKind.RELAY: "relay",
    FrameKind.GLOBAL: "broadcast",
    FrameKind.STATE: "state",
}


@dataclass
class Traffic:
    """Totals of one kind since take-off."""

    transmissions: int = 0
    payload_bits: int = 0  # of what is written, scales included, once a transmission: the paper's count
    wire_bytes: int = 0  # encoded frames, as they crossed the bus on the way to the radio
    sent: int = 0  # link copies
    delivered: int = 0
    outages: int = 0
    slots: int = 0  # spent on all links, lost messages included
    delivered_slots: int = 0
    airtime_s: float = 0.0  # a transmission lasts until its last link is served or given up
    expected_outages: float = 0.0  # closed form, summed over the links used
    expected_delivered_slots: float = 0.0


@dataclass
class Meter:
    """The bill of a run."""

    radio: Radio
    uavs: int
    traffic: dict[FrameKind, Traffic] = field(default_factory=lambda: {kind: Traffic() for kind in FrameKind})

    def __post_init__(self) -> None:
        self._link_sent = np.zeros((self.uavs, self.uavs), dtype=np.int32)
        self._link_outages = np.zeros((self.uavs, self.uavs), dtype=np.int32)
        self._last: Links | None = None  # which mostly are those of the next tick: entered once, with how often
        self._times = 0
        self._figures: tuple[float, ...] | None = None  # of most ticks they are those of the last

    def count(
        self, kind: FrameKind, payload_bits: int, links: Links, distance_m: NDArray[np.float64], came_to: Account
    ) -> None:
        """Enters one batch of transmissions of a kind.

        Args:
            payload_bits: of one transmission. distance_m: (K,), of the links by radio. came_to: over those.
        """
        self._figures = None
        bill = self.traffic[kind]
        bill.transmissions += links.transmissions
        bill.payload_bits += payload_bits * links.transmissions
        if not (copies := len(links.pair)):
            return
        record, outages, slots, longest = came_to
        bill.sent += copies
        bill.delivered += copies - outages
        bill.outages += outages
        bill.slots += slots
        bill.delivered_slots += slots - outages * self.radio.latency_threshold_slots
        bill.airtime_s += longest * self.radio.coherence_time_s
        self._expect(bill, payload_bits, distance_m)
        if links is not self._last:
            self._enter()
            self._last = links
        self._times += 1
        if outages:
            self._link_outages.reshape(-1)[links.pair[record[:, 4] < 0]] += 1

    def initial(self, payload_bits: int) -> None:
        """The mission plan: one state broadcast a UAV before take-off, never in outage."""
        self._figures = None
        bill = self.traffic[FrameKind.STATE]
        bill.transmissions += self.uavs
        bill.payload_bits += payload_bits * self.uavs

    def wire(self, kind: FrameKind, bytes_: int) -> None:
        """Encoded size of frames handed to the radio."""
        self.traffic[kind].wire_bytes += bytes_

    def links(self) -> list[list[int]]:
        """[source, target, sent, outages] of every link that was used, ascending."""
        table: list[list[int]] = self._used().tolist()
        return table

    def total(self, name: str) -> float:
        """Sum of one field of `Traffic` over all kinds."""
        return sum(getattr(bill, name) for bill in self.traffic.values())

    def figures(self) -> tuple[float, ...]:
        """Payload bits by kind of traffic, as in `TRAFFIC`; deliveries, outages and airtime of all."""
        if self._figures is None:
            bits = [self.traffic[kind].payload_bits for kind in TRAFFIC]
            self._figures = *bits, self.total("delivered"), self.total("outages"), self.total("airtime_s")
        return self._figures

    def snapshot(self) -> dict[str, Any]:
        """The bill so far, for `restore`."""
        return {
            "traffic": [asdict(self.traffic[kind]) for kind in FrameKind],
            "links": self._used(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on with the bill of a snapshot."""
        self._figures = None
        self.traffic = {kind: Traffic(**bill) for kind, bill in zip(FrameKind, snapshot["traffic"], strict=True)}
        self._last, self._times = None, 0
        source, target, sent, outages = snapshot["links"].T
        self._link_sent[...], self._link_outages[...] = 0, 0
        self._link_sent[source, target], self._link_outages[source, target] = sent, outages

    def _used(self) -> NDArray[np.int32]:
        """[source, target, sent, outages] of every link that was used, ascending, `(K, 4)`."""
        self._enter()
        used = np.nonzero(self._link_sent)
        return np.stack([*used, self._link_sent[used], self._link_outages[used]], axis=-1).astype(np.int32)

    def _enter(self) -> None:
        if self._last is not None:
            self._link_sent.reshape(-1)[self._last.pair] += self._times
            self._times = 0

    def _expect(self, bill: Traffic, payload_bits: int, distance_m: NDArray[np.float64]) -> None:
        if self.radio.path_loss_exponent == 0.0:  # every link is alike
            copies, (outages, slots) = len(distance_m), _expected_anywhere(self.radio, payload_bits)
        else:
            copies, (outages, slots) = 1, _expected(self.radio, payload_bits, distance_m)
        bill.expected_outages += copies * outages
        bill.expected_delivered_slots += copies * slots


def _expected(radio: Radio, payload_bits: int, distance_m: NDArray[np.float64]) -> tuple[float, float]:
    """Outages and delivered slots to expect of a message over each of these links, summed."""
    success = theory.slot_success(radio, distance_m)
    return (
        float(theory.outage(radio, success, payload_bits).sum()),
        float(theory.delivered_latency(radio, success, payload_bits).sum()),
    )


@lru_cache(maxsize=64)  # by radio and length; a run knows a few
def _expected_anywhere(radio: Radio, payload_bits: int) -> tuple[float, float]:
    return _expected(radio, payload_bits, np.ones(1))
