"""One link: its SNR threshold, the slots that a message needs, closed forms of outage and latency, and their draw."""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.channel import tails
from meanflock.swarm.scenario import Radio
from meanflock.swarm.state import Floats

MOST_SLOTS = 2**31 - 1  # largest number in a record


def slots_needed(radio: Radio, bits: int) -> int:
    """Number K ≥ 1 of successful slots that a message of `bits` needs; at most `MOST_SLOTS`, more than any D_M."""
    return slots_for(bits, radio.bits_per_slot)


def slots_for(bits: int, bits_per_slot: float) -> int:
    """The same at another number of bits a slot."""
    return max(1, math.ceil(bits / bits_per_slot)) if bits < MOST_SLOTS * bits_per_slot else MOST_SLOTS


def squared_threshold(radio: Radio, distance_m: Floats) -> Floats:
    """Value of z² at which SNR = P_o z r^−α / (W_o σ_n) reaches η (with `fading = "power"`: P_o z² …); same shape."""
    power_w = 10.0 ** (radio.tx_power_dbm / 10.0) * 1e-3
    noise_w = radio.bandwidth_hz * 10.0 ** (radio.noise_psd_dbm_hz / 10.0) * 1e-3
    target = 10.0 ** (radio.target_snr_db / 10.0)
    loss = np.power(distance_m, radio.path_loss_exponent) if radio.path_loss_exponent else np.ones_like(distance_m)
    gain = target * noise_w / power_w * loss
    return gain if radio.fading == "power" else gain * gain


def slot_success(radio: Radio, distance_m: Floats) -> Floats:
    """Probability P[SNR ≥ η] = Q₁(ξ/χ, z_η/χ): tail of a non-central χ² with two degrees of freedom; same shape."""
    return tails.rice_above(squared_threshold(radio, distance_m), radio.rice_xi, radio.rice_chi)


def outage(radio: Radio, success: Floats, bits: int) -> Floats:
    """Probability of an outage, P[D_m > D_M]; same shape as `success` p."""
    return lost(slots_needed(radio, bits), radio.latency_threshold_slots, success)


def delivered_latency(radio: Radio, success: Floats, bits: int) -> Floats:
    """Mean latency of delivered messages times their probability, E[D_m; D_m ≤ D_M], in slots."""
    return delivered_slots(slots_needed(radio, bits), radio.latency_threshold_slots, success)


def lost(needed: int, slots: int, success: Floats) -> Floats:
    """P[Binomial(D_M, p) < K]: fewer than K = `needed` of D_M = `slots` are good; same shape as `success` p."""
    return (
        tails.binomial_at_most(needed - 1, slots, success, 1.0 - success) if needed <= slots else np.ones_like(success)
    )


def delivered_slots(needed: int, slots: int, success: Floats) -> Floats:
    """E[D_m; D_m ≤ D_M] for a message that needs K = `needed` good slots of at most D_M = `slots`.

    D_m − K is negative binomial, so this is Σ_{d=K}^{D_M} d (d−1 choose K−1) p^K (1−p)^{d−K} =
    (K/p) P[Binomial(D_M + 1, p) ≥ K + 1].
    """
    if needed > slots:
        return np.zeros_like(success)
    reached = tails.binomial_at_most(slots - needed, slots + 1, 1.0 - success, success)  # slots that failed
    return np.divide(needed * reached, success, out=np.zeros_like(success), where=success > 0)


def drawn(
    needed: int, slots: int, success: Floats, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Draws the slots (K,) that a message takes on links, and whether it is delivered (K,).

    One number is drawn in every slot for each link that is still busy, in link order; none if no link can deliver.
    """
    links = len(success)
    if needed > slots:
        return np.full(links, slots, dtype=np.int64), np.zeros(links, dtype=bool)
    taken = np.empty(links, dtype=np.int64)
    busy, missing, left = np.arange(links), np.full(links, needed), links
    for slot in range(1, slots + 1):
        left = kernels.send(rng.random(left), success, slot, busy, missing, taken)
        if not left:
            break
    delivered = np.ones(links, dtype=bool)
    delivered[busy[:left]] = False
    return taken, delivered


def expected(radio: Radio, distance_m: Floats, bits: int) -> tuple[float, float]:
    """Expected outages and delivered slots of a message, summed over the links `(K,)`."""
    success = slot_success(radio, distance_m)
    return float(outage(radio, success, bits).sum()), float(delivered_latency(radio, success, bits).sum())
