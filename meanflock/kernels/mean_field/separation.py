"""Repulsion from near UAVs, which the paper's cost lacks: its φ_G only aligns velocities."""

import math

import numpy as np

from meanflock.kernels import state
from meanflock.kernels.mean_field.layout import Floats

FARTHEST = 36.0  # d²/2ℓ² beyond which a UAV is ignored: exp(−36) is 2e-16
_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.693147180369123816490, 1.90821492927058770002e-10  # ln 2, the first without its last 32 bits
_SERIES = tuple(1.0 / math.factorial(n) for n in range(13, -1, -1))  # of exp, as in separation.c


def decay(u: Floats) -> Floats:
    """Compute exp(−u) for 0 ≤ u ≤ 36, and 0 elsewhere, `(...)`, by additions and products only, as in C.

    Within 2e-16 relative: u = k ln 2 + r, and the Taylor series of exp(−r), |r| ≤ ln 2 / 2, times 2⁻ᵏ.
    """
    near = u <= FARTHEST
    u = np.where(near, u, 0.0)
    k = np.floor(u * _LOG2_E + 0.5)
    r = k * _LN2_LOW - (u - k * _LN2_HIGH)
    series = np.full_like(u, _SERIES[0])
    for term in _SERIES[1:]:
        series = series * r + term
    return np.where(near, np.ldexp(series, (-k).astype(np.int32)), 0.0)


def repel(states: Floats, known: Floats, weight: float, range_m: float, pushed: Floats) -> None:
    """Repulsion a = w Σ_j Δr exp(−‖Δr‖²/2ℓ²) with Δr = r − r_j, the negative gradient of w ℓ² Σ_j exp(−‖Δr‖²/2ℓ²).

    Args:
        states: (M, 4). known: (M, N, 4), states of all UAVs known to each row; its own adds 0. weight: w, 1/s².
        range_m: ℓ. pushed: (M, 2), written, m/s².
    """
    with np.errstate(over="ignore", invalid="ignore"):
        here, there = state.parts(state.position(states)), state.parts(state.position(known))
        gaps = [own[:, None] - others for own, others in zip(here, there, strict=True)]
        falls = decay(state.squared(gaps) * (0.5 / (range_m * range_m)))
        # NaN and infinite distances get weight 0 and no product.
        for axis, apart in enumerate(gaps):
            products = np.where(falls > 0.0, apart, 0.0) * falls
            pushed[:, axis] = weight * np.add.reduce(products, axis=-1)
