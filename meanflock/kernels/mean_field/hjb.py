"""The value learner: one gradient step a tick on the squared residual of the HJB equation, plus the regulariser.

Weights `(..., 108)` are [ŵ_H0, ŵ_H1]: ψ̂ = ŵ_H0ᵀσ_H and its time derivative ψ̂̇ = ŵ_H1ᵀσ_H.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import state
from meanflock.kernels.mean_field import features
from meanflock.kernels.mean_field.layout import PER_AXIS, Floats, Tables


class ValueStep(NamedTuple):
    """Result of a tick of the value learner.

    weights: (..., 108) after the step.
    action_before, action: â with the weights before and after, (..., 2), m/s².
    residual: e_H before the step, (...).
    curvature: ψ̂_vxvx + ψ̂_vyvy after the step, (...); the divergence of the density learner's drift depends on it.
    """

    weights: Floats
    action_before: Floats
    action: Floats
    residual: Floats
    curvature: Floats


def local_cost(states: Floats, c1: float) -> Floats:
    """Local cost φ_L = v·r/‖r‖ + c1‖v‖², `(...)`; the first term is set to 0 at r = 0, where it is undefined."""
    position, velocity = state.position(states), state.velocity(states)
    distance = np.sqrt(state.dot(position, position))
    approach = state.dot(velocity, position) / np.maximum(distance, np.finfo(np.float64).tiny)
    return approach + c1 * state.dot(velocity, velocity)


def drift(t: Tables, states: Floats, action: Floats) -> Floats:
    """Velocity part of f + Bâ, `(..., 2)`, m/s²."""
    return action - t.drag * (state.velocity(states) - t.wind)


def step(t: Tables, weights: Floats, states: Floats, powers: Floats, phi_g: Floats) -> ValueStep:
    """One step of the value learner, Eq. HJB_update0 and HJB_update1.

    e_H = ŵ_H1ᵀσ + (f − BBᵀ∇ψ̂/4c3)ᵀ∇ψ̂ + ½tr(GGᵀ Hess ψ̂) + φ_L + c2φ_G. With g = ∇_{ŵH0}e_H =
    [∇σ](f + Bâ) + ½d this is ŵ_H1ᵀσ + ŵ_H0ᵀg + c3‖â‖² + φ_L + c2φ_G, so one product serves residual and step.

    Args:
        weights: (..., 108). states: (..., 4). powers: of the states, (..., 28). phi_g: φ_G, (...).
    """
    blocks = features.value(t, powers)  # of axis x and axis y: (..., 2, 27) each
    sigma, by_position, by_velocity, curvature = (blocks[..., k, :, :] for k in range(4))
    rows = weights.shape[:-1]
    per_axis = (*rows, 2, state.axes(states), PER_AXIS)  # [ŵ_H0, ŵ_H1] of axis x and axis y

    action_before = -t.gain * state.dot(by_velocity, weights.reshape(per_axis)[..., 0, :, :])
    before = drift(t, states, action_before)
    gradient = np.empty(per_axis)
    first = gradient[..., 0, :, :]
    np.multiply(curvature, t.half_variance, out=first)
    first += state.velocity(states)[..., None] * by_position
    first += before[..., None] * by_velocity
    gradient[..., 1, :, :] = sigma
    flat = gradient.reshape(weights.shape)

    residual = state.dot(weights, flat)
    residual += t.c3 * state.dot(action_before, action_before)
    residual += local_cost(states, t.c1)
    residual += t.c2 * phi_g

    stepped = weights - (t.mu_h * residual)[..., None] * flat
    value = stepped.reshape(per_axis)[..., 0, :, :]
    active = _regularised(t, states, before)
    if active.any():
        slope = t.kappa * state.position(states) + state.velocity(states)  # Bᵀ∇L_s
        push = (t.push * slope)[..., None] * by_velocity
        np.add(value, push, out=value, where=active[..., None, None])
    whole = (*rows, state.axes(states) * PER_AXIS)
    action = -t.gain * state.dot(by_velocity, value)
    bend = state.dot(curvature.reshape(whole), value.reshape(whole))
    return ValueStep(stepped, action_before, action, residual, bend)


def lyapunov_rate(t: Tables, states: Floats, drift: Floats) -> Floats:
    """Rate L̇_s = ∇L_sᵀ(f + Bâ) of L_s = ½sᵀPs, P = [[1, κ], [κ, 1]] ⊗ I₂; `(...)`."""
    position, velocity = state.position(states), state.velocity(states)
    by_position = position + t.kappa * velocity
    by_velocity = t.kappa * position + velocity
    return state.dot(by_position, velocity) + state.dot(by_velocity, drift)


def _regularised(t: Tables, states: Floats, drift: Floats) -> NDArray[np.bool_]:
    """Mask of the rows in which R = max(0, L̇_s)·1[‖s‖ ≥ s_dest] has a gradient.

    There ∇_{ŵH0}R = −(1/2c3)[∇σ]B Bᵀ∇L_s; the appendix prints the opposite sign, which would drive L̇_s up.
    """
    return (lyapunov_rate(t, states, drift) > 0) & (state.dot(states, states) >= t.arrived_squared)
