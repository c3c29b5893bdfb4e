"""The value learner: one gradient step a tick on the squared residual of the HJB equation, plus the regulariser.

Weights `(..., 2, 54)` are [ŵ_H0, ŵ_H1]: ψ̂ = ŵ_H0ᵀσ_H and its time derivative ψ̂̇ = ŵ_H1ᵀσ_H.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.basis import ValueBasis
from agent.weights import VALUE_FEATURES
from swarm import state
from swarm.scenario import Scenario

Floats = NDArray[np.float64]


class HjbResult(msgspec.Struct, frozen=True, eq=False):
    """One tick of the value learner.

    weights: (..., 2, 54) after the step.
    action_before, action: â with the weights before and after, (..., 2), m/s².
    residual: e_H before the step, (...).
    curvature: ψ̂_vxvx + ψ̂_vyvy after the step, (...); the density learner's drift diverges by it.
    """

    weights: Floats
    action_before: Floats
    action: Floats
    residual: Floats
    curvature: Floats


def local_cost(states: Floats, c1: float) -> Floats:
    """φ_L = v·r/‖r‖ + c1‖v‖², `(...)`; the first term is 0 at r = 0, where it is undefined."""
    position, velocity = states[..., state.POSITION], states[..., state.VELOCITY]
    distance = np.sqrt(state.dot(position, position))
    approach = state.dot(velocity, position) / np.maximum(distance, np.finfo(np.float64).tiny)
    return approach + c1 * state.dot(velocity, velocity)


class HjbLearner:
    """The step, with the scenario's constants."""

    def __init__(self, scenario: Scenario) -> None:
        self.basis = ValueBasis(scenario.learner)
        self._cost = scenario.cost
        self._learner = scenario.learner
        self.drag_coefficient = scenario.wind.drag
        self.wind = np.array(scenario.wind.mean)
        self.half_variance = 0.5 * scenario.wind.sigma**2
        self.gain = 1.0 / (2.0 * scenario.cost.c3)
        self.push = self._learner.mu_h * self._learner.c_h * self.gain  # of the regulariser
        self.arrived_squared = scenario.destination.radius**2

    def init(self, rows: int) -> Floats:
        """ŵ_H0 = ŵ_H1 = 0, `(rows, 2, 54)`."""
        return np.zeros((rows, 2, VALUE_FEATURES))

    def drift(self, states: Floats, action: Floats) -> Floats:
        """Velocity part of f + Bâ, `(..., 2)`, m/s²."""
        return action - self.drag_coefficient * (states[..., state.VELOCITY] - self.wind)

    def step(self, weights: Floats, states: Floats, powers: Floats, phi_g: Floats) -> HjbResult:
        """Eq. HJB_update0 and HJB_update1.

        e_H = ŵ_H1ᵀσ + (f − BBᵀ∇ψ̂/4c3)ᵀ∇ψ̂ + ½tr(GGᵀ Hess ψ̂) + φ_L + c2φ_G. With g = ∇_{ŵH0}e_H =
        [∇σ](f + Bâ) + ½d this is ŵ_H1ᵀσ + ŵ_H0ᵀg + c3‖â‖² + φ_L + c2φ_G, so one product serves residual and step.

        Args:
            weights: (..., 2, 54). states: (..., 4). powers: of the states, (..., 4, 7). phi_g: φ_G, (...).
        """
        features = self.basis(powers)  # of axis x and axis y: (..., 2, 27) each
        sigma, by_position = features[..., 0, :, :], features[..., 1, :, :]
        by_velocity, curvature = features[..., 2, :, :], features[..., 3, :, :]
        per_axis = (*weights.shape[:-1], *sigma.shape[-2:])  # [ŵ_H0, ŵ_H1] of axis x and axis y
        whole = (*weights.shape[:-2], VALUE_FEATURES)
        flat = (*weights.shape[:-2], 2 * VALUE_FEATURES)

        action_before = -self.gain * state.dot(by_velocity, weights.reshape(per_axis)[..., 0, :, :])
        drift = self.drift(states, action_before)
        gradient = np.empty(per_axis)
        first = gradient[..., 0, :, :]
        np.multiply(curvature, self.half_variance, out=first)
        first += states[..., state.VELOCITY, None] * by_position
        first += drift[..., None] * by_velocity
        gradient[..., 1, :, :] = sigma

        residual = state.dot(weights.reshape(flat), gradient.reshape(flat))
        residual += self._cost.c3 * state.dot(action_before, action_before)
        residual += local_cost(states, self._cost.c1)
        residual += self._cost.c2 * phi_g

        stepped = weights.reshape(per_axis) - (self._learner.mu_h * residual)[..., None, None, None] * gradient
        active = self._regularised(states, drift)
        value = stepped[..., 0, :, :]
        if active.any():
            slope = self._learner.kappa * states[..., state.POSITION] + states[..., state.VELOCITY]  # Bᵀ∇L_s
            push = (self.push * slope)[..., None] * by_velocity
            np.add(value, push, out=value, where=active[..., None, None])

        return HjbResult(
            weights=stepped.reshape(weights.shape),
            action_before=action_before,
            action=-self.gain * state.dot(by_velocity, value),
            residual=residual,
            curvature=state.dot(curvature.reshape(whole), value.reshape(whole)),
        )

    def lyapunov_rate(self, states: Floats, drift: Floats) -> Floats:
        """L̇_s = ∇L_sᵀ(f + Bâ) of L_s = ½sᵀPs, P = [[1, κ], [κ, 1]] ⊗ I₂; `(...)`."""
        position, velocity = states[..., state.POSITION], states[..., state.VELOCITY]
        by_position = position + self._learner.kappa * velocity
        by_velocity = self._learner.kappa * position + velocity
        return state.dot(by_position, velocity) + state.dot(by_velocity, drift)

    def _regularised(self, states: Floats, drift: Floats) -> NDArray[np.bool_]:
        """Where R = max(0, L̇_s)·1[‖s‖ ≥ s_dest] has a gradient.

        There ∇_{ŵH0}R = −(1/2c3)[∇σ]B Bᵀ∇L_s; the appendix prints the opposite sign, which would drive L̇_s up.
        """
        return (self.lyapunov_rate(states, drift) > 0) & (state.dot(states, states) >= self.arrived_squared)
