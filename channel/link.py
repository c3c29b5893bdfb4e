"""One link: from distance to SNR threshold, from bits to slots, from slots to latency or outage."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from channel.fading import Fading
from swarm.scenario import Radio

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Transmission:
    """What became of one message on each of K links.

    slots: (K,) slots spent: D_m where delivered, D_M where not. delivered: (K,) bool.
    """

    slots: Counts
    delivered: NDArray[np.bool_]

    @property
    def outages(self) -> int:
        """On how many links it was not delivered."""
        return len(self.delivered) - int(np.count_nonzero(self.delivered))


def bits_per_slot(radio: Radio) -> float:
    """θ W_o log₂(1 + η): what a slot carries if its SNR reaches the target."""
    return radio.coherence_time_s * radio.bandwidth_hz * math.log2(1.0 + 10.0 ** (radio.target_snr_db / 10.0))


def slots_needed(radio: Radio, bits: int) -> int:
    """K: successful slots a message of `bits` needs, at least one."""
    return max(1, math.ceil(bits / bits_per_slot(radio)))


def squared_threshold(radio: Radio, distance_m: Floats) -> Floats:
    """The z² at which SNR = P_o z r^−α / (W_o σ_n) reaches η (with `fading = "power"`: P_o z² …); same shape."""
    power_w = 10.0 ** (radio.tx_power_dbm / 10.0) * 1e-3
    noise_w = radio.bandwidth_hz * 10.0 ** (radio.noise_psd_dbm_hz / 10.0) * 1e-3
    target = 10.0 ** (radio.target_snr_db / 10.0)
    loss = np.power(distance_m, radio.path_loss_exponent) if radio.path_loss_exponent else np.ones_like(distance_m)
    gain = target * noise_w / power_w * loss
    return gain if radio.fading == "power" else gain * gain


def transmit(radio: Radio, fading: Fading, distance_m: Floats, bits: int) -> Transmission:
    """Sends one message over K independent links, slot by slot, until it is through or D_M slots are spent.

    In every slot an amplitude is drawn for each link still busy, in link order, so the result depends on the
    fading and the order of the links only.

    Args:
        distance_m: (K,). bits: length of the message.
    """
    needed = slots_needed(radio, bits)
    if not radio.path_loss_exponent and needed == 1:
        return _short(radio.latency_threshold_slots, fading, _threshold_anywhere(radio), len(distance_m))
    threshold = squared_threshold(radio, distance_m)
    slots = np.zeros(len(distance_m), dtype=np.int64)
    busy: slice | NDArray[np.intp] = slice(None)  # all, without a copy: most messages are through in the first slot
    missing, left = np.full(len(distance_m), needed), len(distance_m)  # slots of the busy, and how many those are
    for slot in range(1, radio.latency_threshold_slots + 1):
        if not left:
            break
        slots[busy] = slot
        failed = fading.squared(left) < threshold[busy]
        if needed > 1:
            missing -= ~failed
            failed = missing > 0
            missing = missing[failed]
        still = failed.nonzero()[0]
        busy, left = still if isinstance(busy, slice) else busy[still], len(still)
    delivered = np.ones(len(slots), dtype=bool)
    delivered[busy] = False
    return Transmission(slots, delivered)


def _short(slots_at_most: int, fading: Fading, threshold: float, count: int) -> Transmission:
    """A message that is through with the first slot that reaches the threshold, the same on all of `count` links.

    A link spends one slot more than it fails; so what is kept of a slot is who goes on, and that is counted once.
    """
    busy = fading.failing(threshold, count)
    again = [busy]
    for _ in range(1, slots_at_most):
        if not (left := len(busy)):
            break
        busy = busy[fading.failing(threshold, left)]
        again.append(busy)
    delivered = np.ones(count, dtype=bool)
    delivered[again.pop()] = False  # of the last slot nobody goes on; who would is lost
    slots = np.bincount(np.concatenate(again), minlength=count) if again else np.zeros(count, dtype=np.int64)
    slots += 1
    return Transmission(slots, delivered)


@lru_cache(maxsize=64)  # a run knows one
def _threshold_anywhere(radio: Radio) -> float:
    return float(squared_threshold(radio, np.ones(1))[0])
