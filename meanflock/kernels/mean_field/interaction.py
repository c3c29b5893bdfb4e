"""The interaction term φ_G: the difference of velocities in the neighbourhood.

If states are shared, it is the paper's empirical mean over the states received. If a density is learned, it is a
quadrature of m̂ over nodes that move with the UAV.
"""

import numpy as np

from meanflock.kernels import state
from meanflock.kernels.mean_field.layout import Floats, Tables

_ROWS_AT_ONCE = 64  # 36 KB each, while they are summed


def kernel(velocity_difference: Floats, position_difference: Floats, epsilon: float, beta: float = 1.0) -> Floats:
    """Interaction kernel K = ‖Δv‖²/(ε + ‖Δr‖²)^β of differences `(..., 2)`; `(...)`."""
    distance = epsilon + state.dot(position_difference, position_difference)
    if beta != 1.0:
        distance = distance**beta
    return state.dot(velocity_difference, velocity_difference) / distance


def empirical(states: Floats, known: Floats, epsilon: float, beta: float = 1.0) -> Floats:
    """Empirical φ_G(s_i; s_−i), Eq. InterAction01: the mean of K over the states known to a UAV.

    Args:
        states: (..., 4). known: (..., N, 4), states of all N UAVs known to each UAV, itself included.
    """
    difference = known - states[..., None, :]
    return kernel(state.velocity(difference), state.position(difference), epsilon, beta).mean(axis=-1)


def density(t: Tables, weights: Floats, terms: Floats) -> Floats:
    """Density m̂ at the nodes around each state, `(..., 64)`. Weights: ŵ_F0 `(..., 69)`; terms: [1, σ_F] `(..., 70)`.

    m̂(s + δ) is a polynomial in δ whose coefficients are those of m̂ re-expanded about s, exactly:
    c_n = Σ_r ŵ_{n+r} (n+r choose n) s̄^r = (1/n!) Σ_r (ŵ_{n+r} (n+r)!) (s̄^r / r!).
    That costs 494 products instead of evaluating 69 monomials at 64 nodes.
    """
    products = (weights * t.factorial[1:]).take(t.weight, axis=-1)
    products *= (terms / t.factorial).take(t.term, axis=-1)
    expansion = np.add.reduceat(products, t.starts[:-1], axis=-1).reshape(-1, len(t.monomials))
    # Term by term, because the order of a BLAS depends on the machine and on the number of rows.
    at_nodes = [
        np.add.reduce(expansion[start : start + _ROWS_AT_ONCE, :, None] * t.monomials, axis=-2)
        for start in range(0, len(expansion), _ROWS_AT_ONCE)
    ]
    return np.concatenate([np.zeros((0, len(t.kernel))), *at_nodes]).reshape(*weights.shape[:-1], len(t.kernel))


def quadrature(t: Tables, weights: Floats, terms: Floats) -> Floats:
    """Quadrature φ_G(s; m̂) = Σ ω_q K(s, s + δ_q), Eq. InterAction03, ω = max(m̂, 0) normalised over fixed offsets δ.

    K depends on δ only. The result `(...)` is 0 if m̂ is not positive at any node.
    """
    mass = np.maximum(density(t, weights, terms), 0.0)
    return (mass * t.kernel).sum(axis=-1) / np.maximum(mass.sum(axis=-1), np.finfo(np.float64).tiny)
