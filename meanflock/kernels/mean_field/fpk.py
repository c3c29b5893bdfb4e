"""The density learner: one gradient step a tick on the squared residual of the FPK equation.

Weights `(..., 138)` are [ŵ_F0, ŵ_F1]: m̂ = ŵ_F0ᵀσ_F and its time derivative m̂̇ = ŵ_F1ᵀσ_F.
"""

import numpy as np

from meanflock.kernels import state
from meanflock.kernels.mean_field.layout import Floats, Tables


def divergence(t: Tables, curvature: Floats) -> Floats:
    """Divergence of the drift, ∇·b = −d c0 − (ψ̂_vxvx + ψ̂_vyvy)/2c3, `(...)`, 1/s."""
    return -float(len(t.wind)) * t.drag - t.gain * curvature


def operator(t: Tables, pairs: Floats, b: Floats, divergence: Floats) -> Floats:
    """FPK operator ∇_{ŵF0} e_F = σ_F ∇·b + [∇σ_F] b − ½ [tr(GGᵀ Hess σ_F)], `(..., 69)`.

    The operator acts on a product by the product rule: on pairs first, then on terms.

    Args:
        pairs: of the states, `(..., 8, 15)`. b: the drift, `(..., 4)`, m/s and m/s². divergence: ∇·b, `(...)`, 1/s.
    """
    axes = state.axes(b)
    at_velocity = 1 + axes  # of the pairs of velocities
    factors = np.empty((*pairs.shape[:-1], 1))
    factors[..., 0, 0] = divergence
    factors[..., 1:at_velocity, 0] = state.position(b)  # ṙ of the state, in the order of the derivatives
    factors[..., at_velocity, 0] = 0.0
    factors[..., at_velocity + 1 : -axes, 0] = state.velocity(b)
    factors[..., -axes:, 0] = -t.half_variance
    images = factors * pairs
    each = pairs.shape[-1]
    blocks = np.empty((*b.shape[:-1], 4, each))
    blocks[..., 0, :] = pairs[..., 0, :]
    parts = [images[..., part, :] for part in range(images.shape[-2])]
    blocks[..., 1, :] = sum(parts[1:at_velocity], parts[0])
    blocks[..., 2, :] = pairs[..., at_velocity, :]
    blocks[..., 3, :] = sum(parts[at_velocity + 2 :], parts[at_velocity + 1])
    flat = blocks.reshape(*blocks.shape[:-2], 4 * each)
    products = flat.take(t.left, axis=-1)
    products *= flat.take(t.right, axis=-1)
    half = products.shape[-1] // 2
    return (products[..., :half] + products[..., half:]) * t.coefficient[1:]


def step(
    t: Tables, weights: Floats, states: Floats, pairs: Floats, sigma: Floats, drift: Floats, curvature: Floats
) -> tuple[Floats, Floats]:
    """One step of the density learner, Eq. FPK_update0 and FPK_update1, with ψ̂ after the value step (Algorithm 2).

    e_F = ŵ_F1ᵀσ_F + ŵ_F0ᵀg with g = σ_F∇·b + [∇σ_F]b − ½[tr(GGᵀ Hess σ_F)].

    Args:
        weights: (..., 138). states: (..., 4). pairs: of the states, (..., 8, 15). sigma: σ_F, (..., 69).
        drift: velocity part of b, (..., 2), m/s². curvature: ψ̂_vxvx + ψ̂_vyvy, (...).

    Returns:
        Weights after the step, and the residual e_F (...) before it.
    """
    b = np.concatenate([state.velocity(states), drift], axis=-1)
    gradient = np.concatenate([operator(t, pairs, b, divergence(t, curvature)), sigma], axis=-1)
    residual = state.dot(weights, gradient)
    return weights - (t.mu_f * residual)[..., None] * gradient, residual
