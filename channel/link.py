"""The budget of a link: from distance to SNR threshold, from bits to slots."""

import math

import numpy as np

from meanflock.swarm.scenario import Radio
from meanflock.swarm.state import Floats

MOST_SLOTS = 2**31 - 1  # a record has no room for more


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
