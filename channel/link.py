"""One link: from distance to SNR threshold, from bits to slots, from slots to latency or outage."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from channel import kernel
from channel.fading import Fading
from swarm.scenario import Radio

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


MOST_SLOTS = 2**31 - 1  # a record has no room for more


class Transmission(NamedTuple):
    """What became of one message on each of K links.

    slots: (K,) slots spent: D_m where delivered, D_M where not. missing: (K,) successful slots it lacks, 0 where
    delivered.
    """

    slots: Counts
    missing: Counts

    @property
    def delivered(self) -> NDArray[np.bool_]:
        """On which links it was, (K,)."""
        return self.missing == 0


def bits_per_slot(radio: Radio) -> float:
    """θ W_o log₂(1 + η): what a slot carries if its SNR reaches the target."""
    return radio.coherence_time_s * radio.bandwidth_hz * math.log2(1.0 + 10.0 ** (radio.target_snr_db / 10.0))


def slots_needed(radio: Radio, bits: int) -> int:
    """K: successful slots a message of `bits` needs, at least one; at most `MOST_SLOTS`, which no D_M comes near."""
    per_slot = bits_per_slot(radio)
    return max(1, math.ceil(bits / per_slot)) if bits < MOST_SLOTS * per_slot else MOST_SLOTS


def squared_threshold(radio: Radio, distance_m: Floats) -> Floats:
    """The z² at which SNR = P_o z r^−α / (W_o σ_n) reaches η (with `fading = "power"`: P_o z² …); same shape."""
    power_w = 10.0 ** (radio.tx_power_dbm / 10.0) * 1e-3
    noise_w = radio.bandwidth_hz * 10.0 ** (radio.noise_psd_dbm_hz / 10.0) * 1e-3
    target = 10.0 ** (radio.target_snr_db / 10.0)
    loss = np.power(distance_m, radio.path_loss_exponent) if radio.path_loss_exponent else np.ones_like(distance_m)
    gain = target * noise_w / power_w * loss
    return gain if radio.fading == "power" else gain * gain


def transmit(radio: Radio, fading: Fading, distance_m: Floats, bits: int, *, compiled: bool = True) -> Transmission:
    """Sends one message over K independent links, slot by slot, until it is through or D_M slots are spent.

    In every slot an amplitude is drawn for each link still busy, in link order, so the result depends on the
    fading and the order of the links only.

    Args:
        distance_m: (K,). bits: length of the message.
        compiled: with the compiled kernel, if this installation has it; the bits are the same.
    """
    needed, threshold = _terms(radio, bits)
    if radio.path_loss_exponent:
        threshold = squared_threshold(radio, distance_m)
    carry = kernel.carry if compiled and kernel.is_compiled() else _carry
    return Transmission(*carry(fading, threshold, len(distance_m), needed, radio.latency_threshold_slots))


def _carry(fading: Fading, threshold: Floats, links: int, needed: int, slots_at_most: int) -> tuple[Counts, Counts]:
    """See `kernel.carry`."""
    slots, missing = np.zeros(links, dtype=np.int64), np.full(links, needed)
    threshold, busy = np.broadcast_to(threshold, links), np.arange(links)
    for slot in range(1, slots_at_most + 1):
        if not len(busy):
            break
        slots[busy] = slot
        missing[busy] -= fading.squared(len(busy)) >= threshold[busy]
        busy = busy[missing[busy] > 0]
    return slots, missing


@lru_cache(maxsize=64)  # by radio and length; a run knows a few
def _terms(radio: Radio, bits: int) -> tuple[int, Floats]:
    """Slots needed, and the threshold (1,) of z² where no length makes a difference."""
    return slots_needed(radio, bits), squared_threshold(radio, np.ones(1))
