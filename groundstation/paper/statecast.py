"""hjb's radio for many runs at once: every UAV broadcasts its state in every tick, N(N − 1) links a run.

One tick of `channel.air.Air` costs more than the learners of the same tick. This is the same exchange, draw by draw
and sum by sum, over all runs as one array, for links that deliver within a tick (D_M θ ≤ dt).
"""

import numpy as np
from numpy.typing import NDArray

from channel import theory
from channel.link import slots_needed, squared_threshold
from channel.meter import Meter
from channel.rician import squared_amplitude
from swarm import state
from swarm.messages import FrameKind
from swarm.scenario import Radio, Scenario
from swarm.seeds import generator

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class _Bill(Meter):
    """A meter that takes the links of a whole flight at once."""

    def settle(self, sent: NDArray[np.int32], outages: NDArray[np.int32]) -> None:
        """Copies and outages of every link, `(N, N)` each."""
        self._link_sent += sent
        self._link_outages += outages


class StateCast:
    """The state broadcasts of R runs of one scenario, which differ in their seeds."""

    @staticmethod
    def fits(scenario: Scenario) -> bool:
        """Whether every delivery comes in the next tick."""
        return scenario.radio.latency_threshold_slots * scenario.radio.coherence_time_s <= scenario.dt

    def __init__(self, scenario: Scenario, seeds: list[int]) -> None:
        n = scenario.uavs
        self._radio: Radio = scenario.radio
        self._bits = state.SIZE * self._radio.bits_per_float
        self._draws = [generator(seed, "radio") for seed in seeds]
        self.meters = [_Bill(self._radio, n) for _ in seeds]
        self._sent = np.zeros((len(seeds), n, n), dtype=np.int32)
        self._outages = np.zeros((len(seeds), n, n), dtype=np.int32)
        self._alike: tuple[float, float] | None = None
        if self._radio.path_loss_exponent == 0.0:
            self._alike = self._expected(np.ones(1))

    def send(self, states: Floats, speaks: Mask) -> Mask:
        """One tick.

        Args:
            states: (R, N, 4). speaks: (R, N), who transmits.

        Returns:
            (R, N, N) bool: whether [run, target] will know the state of [source] in the next tick.
        """
        runs, n = speaks.shape
        position = states[..., state.POSITION]
        difference = position[:, :, None, :] - position[:, None, :, :]
        squared = (difference * difference).sum(axis=-1)
        wanted = squared <= self._radio.range_m**2
        wanted &= speaks[:, :, None] & ~np.eye(n, dtype=bool)
        link = np.flatnonzero(wanted)  # run, source, target ascending: the order of the draws
        run = link // (n * n)
        copies = np.bincount(run, minlength=runs)
        distance = np.sqrt(squared.reshape(-1)[link]) if self._alike is None else np.ones(1)
        slots, missing = self._transmit(run, squared_threshold(self._radio, distance))

        spent = np.zeros(wanted.size, dtype=np.int64)
        spent[link] = slots
        spent = spent.reshape(wanted.shape)
        delivered = np.zeros(wanted.size, dtype=bool)
        delivered[link] = missing <= 0
        delivered = delivered.reshape(wanted.shape)
        self._count(wanted, delivered, spent, speaks, copies, distance)
        return delivered.transpose(0, 2, 1)

    def keep(self, rows: Mask) -> None:
        """Drops the runs that ended; the meters of those are complete."""
        self.settle()
        self._draws = [draw for draw, kept in zip(self._draws, rows, strict=True) if kept]
        self.meters = [meter for meter, kept in zip(self.meters, rows, strict=True) if kept]
        self._sent, self._outages = self._sent[rows], self._outages[rows]

    def settle(self) -> None:
        """Brings the link tables of all meters up to date."""
        for meter, sent, outages in zip(self.meters, self._sent, self._outages, strict=True):
            meter.settle(sent, outages)
        self._sent[...] = 0
        self._outages[...] = 0

    def _transmit(self, run: NDArray[np.intp], threshold: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """See `channel.link.transmit`: slots spent and slots still missing of each link, by run."""
        slots = np.zeros(len(run), dtype=np.int64)
        missing = np.full(len(run), slots_needed(self._radio, self._bits))
        busy = np.arange(len(run))
        alike = len(threshold) == 1
        for _ in range(self._radio.latency_threshold_slots):
            if not len(busy):
                break
            normal = _normal(self._draws, np.bincount(run[busy], minlength=len(self._draws)))
            squared = squared_amplitude(normal, self._radio.rice_xi, self._radio.rice_chi)
            slots[busy] += 1
            missing[busy] -= squared >= (threshold if alike else threshold[busy])
            busy = busy[missing[busy] > 0]
        return slots, missing

    def _count(
        self,
        wanted: Mask,
        delivered: Mask,
        spent: NDArray[np.int64],
        speaks: Mask,
        copies: NDArray[np.intp],
        distance: Floats,
    ) -> None:
        self._sent += wanted
        self._outages += wanted & ~delivered
        through = delivered.sum(axis=(1, 2)).tolist()
        slots = spent.sum(axis=(1, 2)).tolist()
        delivered_slots = np.where(delivered, spent, 0).sum(axis=(1, 2)).tolist()
        longest = spent.max(axis=2).sum(axis=1).tolist()
        speakers = speaks.sum(axis=1).tolist()
        start = 0
        for row, (meter, links) in enumerate(zip(self.meters, copies.tolist(), strict=True)):
            bill = meter.traffic[FrameKind.STATE]
            if not speakers[row]:
                continue
            bill.transmissions += speakers[row]
            bill.payload_bits += self._bits * speakers[row]
            bill.sent += links
            bill.delivered += through[row]
            bill.outages += links - through[row]
            bill.slots += slots[row]
            bill.delivered_slots += delivered_slots[row]
            bill.airtime_s += float(longest[row]) * self._radio.coherence_time_s
            if self._alike is None:
                outages, latency = self._expected(distance[start : start + links])
                bill.expected_outages += outages
                bill.expected_delivered_slots += latency
            elif links:
                bill.expected_outages += links * self._alike[0]
                bill.expected_delivered_slots += links * self._alike[1]
            start += links

    def _expected(self, distance_m: Floats) -> tuple[float, float]:
        """Closed forms summed over links: outages, and slots of what is delivered."""
        success = theory.slot_success(self._radio, distance_m)
        return (
            float(theory.outage(self._radio, success, self._bits).sum()),
            float(theory.delivered_latency(self._radio, success, self._bits).sum()),
        )


def _normal(draws: list[np.random.Generator], counts: NDArray[np.intp]) -> Floats:
    """Standard normal numbers for so many slots of each run, run by run, two a slot."""
    normal = np.empty((int(counts.sum()), 2))
    end = 0
    for draw, count in zip(draws, counts.tolist(), strict=True):
        draw.standard_normal(out=normal[end : end + count])
        end += count
    return normal
