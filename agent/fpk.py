"""The density learner: one gradient step a tick on the squared residual of the FPK equation.

Weights `(..., 2, 69)` are [ŵ_F0, ŵ_F1]: m̂ = ŵ_F0ᵀσ_F and its time derivative m̂̇ = ŵ_F1ᵀσ_F.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.basis import DensityBasis
from swarm import state
from swarm.scenario import Scenario

Floats = NDArray[np.float64]


class FpkResult(msgspec.Struct, frozen=True, eq=False):
    """One tick of the density learner: weights (..., 2, 69) after the step, residual e_F (...) before it."""

    weights: Floats
    residual: Floats


class FpkLearner:
    """The step, with the scenario's constants."""

    def __init__(self, scenario: Scenario) -> None:
        self.basis = DensityBasis(scenario.learner, scenario.wind.sigma)
        self._step_size = scenario.learner.mu_f
        self._drag = scenario.wind.drag
        self._gain = 1.0 / (2.0 * scenario.cost.c3)

    def divergence(self, curvature: Floats) -> Floats:
        """∇·b = −2c0 − (ψ̂_vxvx + ψ̂_vyvy)/2c3, `(...)`, 1/s."""
        return -2.0 * self._drag - self._gain * curvature

    def step(
        self, weights: Floats, states: Floats, pairs: Floats, sigma: Floats, drift: Floats, curvature: Floats
    ) -> FpkResult:
        """Eq. FPK_update0 and FPK_update1, with ψ̂ as it is after the value step of the same tick (Algorithm 2).

        e_F = ŵ_F1ᵀσ_F + ŵ_F0ᵀg with g = σ_F∇·b + [∇σ_F]b − ½[tr(GGᵀ Hess σ_F)].

        Args:
            weights: (..., 2, 69). states: (..., 4). pairs: of the states, (..., 8, 15). sigma: σ_F, (..., 69).
            drift: velocity part of b, (..., 2), m/s². curvature: ψ̂_vxvx + ψ̂_vyvy, (...).
        """
        b = np.concatenate([states[..., state.VELOCITY], drift], axis=-1)
        gradient = np.empty(weights.shape)
        gradient[..., 0, :] = self.basis.operator(pairs, b, self.divergence(curvature))
        gradient[..., 1, :] = sigma
        flat = (*weights.shape[:-2], weights.shape[-2] * weights.shape[-1])
        residual = state.dot(weights.reshape(flat), gradient.reshape(flat))
        return FpkResult(weights - (self._step_size * residual)[..., None, None] * gradient, residual)
