"""Closed forms of the link, to stand beside what a run observed."""

import numpy as np
from scipy import special

from meanflock.channel.link import slots_needed, squared_threshold
from meanflock.swarm.scenario import Radio
from meanflock.swarm.state import Floats


def slot_success(radio: Radio, distance_m: Floats) -> Floats:
    """P[SNR ≥ η] = Q₁(ξ/χ, z_η/χ), the tail of a non-central χ² with two degrees of freedom; same shape."""
    variance = radio.rice_chi**2
    return 1.0 - special.chndtr(squared_threshold(radio, distance_m) / variance, 2.0, radio.rice_xi**2 / variance)


def outage(radio: Radio, success: Floats, bits: int) -> Floats:
    """P[D_m > D_M] = P[Binomial(D_M, p) < K]; same shape as `success` p."""
    needed, slots = slots_needed(radio, bits), radio.latency_threshold_slots
    return special.bdtr(float(needed - 1), slots, success) if needed <= slots else np.ones_like(success)


def delivered_latency(radio: Radio, success: Floats, bits: int) -> Floats:
    """E[D_m; D_m ≤ D_M] in slots: the latency a run can observe, times the probability of observing it.

    D_m − K is negative binomial, so this is Σ_{d=K}^{D_M} d (d−1 choose K−1) p^K (1−p)^{d−K} =
    (K/p) P[Binomial(D_M + 1, p) ≥ K + 1].
    """
    needed, slots = slots_needed(radio, bits), radio.latency_threshold_slots
    if needed > slots:
        return np.zeros_like(success)
    reached = special.bdtrc(float(needed), slots + 1, success)
    return np.divide(needed * reached, success, out=np.zeros_like(success), where=success > 0)


def expected(radio: Radio, distance_m: Floats, bits: int) -> tuple[float, float]:
    """Outages and delivered slots to expect of a message over each of these links `(K,)`, summed."""
    success = slot_success(radio, distance_m)
    return float(outage(radio, success, bits).sum()), float(delivered_latency(radio, success, bits).sum())
