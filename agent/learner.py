"""One tick of a UAV's mind: φ_G, value step, density step, action. State in, state out; all arrays are rows."""

import numpy as np
from numpy.typing import NDArray

from agent import interaction
from agent.basis import Powers
from agent.density import fit
from agent.fpk import FpkLearner
from agent.hjb import HjbLearner
from agent.kernel import Kernel
from agent.minds import Minds, Outcome
from agent.weights import DENSITY, DENSITY_FEATURES, VALUE
from swarm.scenario import Scenario

Floats = NDArray[np.float64]


class _Learner:
    """Algorithm 1 (hjb) and the local part of Algorithms 2 and 3 (all others)."""

    def __init__(self, scenario: Scenario, *, learns_density: bool = True, compiled: bool = True) -> None:
        """`compiled`: with the compiled kernel, if this installation has it; the bits are the same."""
        self._scenario, self._learns_density = scenario, learns_density
        self._powers = Powers(scenario.learner)
        self._hjb = HjbLearner(scenario)
        self._fpk = FpkLearner(scenario)
        self._quadrature = interaction.Quadrature(scenario)
        self.kernel: Kernel | None = None
        if compiled and Kernel.serves(scenario, learns_density):
            self.kernel = Kernel(scenario, learns_density, self._hjb, self._fpk, self._quadrature)

    def init(self, rows: int, initial_states: Floats) -> Minds:
        """Minds at take-off; every UAV fits the same density to the initial states of all, `(N, 4)`."""
        value = self._hjb.init(rows)
        if not self._learns_density:
            return Minds(value, np.zeros((rows, 2, DENSITY_FEATURES)))
        return Minds(value, np.repeat(fit(self._scenario, initial_states)[None], rows, axis=0))

    def refit(self, minds: Minds, known: Floats) -> Minds:
        """Fits the density of every row anew to the states it knows, `(M, N, 4)`."""
        fitted = np.stack([fit(self._scenario, states) for states in known])
        return Minds(minds.value, np.stack([fitted[:, 0], minds.density[:, 1]], axis=1))

    def step(self, minds: Minds, states: Floats, known: Floats | None) -> Outcome:
        """One update of each network and the action that follows.

        Args:
            states: (M, 4). known: (M, N, 4), the states each row knows, for hjb; None for the others.
        """
        learns_density = self._learns_density
        if not learns_density and known is None:
            raise ValueError("hjb needs the states its rows know")
        if self.kernel is not None:
            return self.kernel(minds, states, None if learns_density else known)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return self._step(minds, states, known)

    def _step(self, minds: Minds, states: Floats, known: Floats | None) -> Outcome:
        powers = self._powers(states)
        if known is not None and not self._learns_density:
            phi_g = interaction.empirical(states, known, self._scenario.cost)
            hjb = self._hjb.step(minds.value, states, powers, phi_g)
            minds = Minds(hjb.weights, minds.density)
            return Outcome.of(minds, hjb.action, hjb.residual, np.zeros_like(phi_g), phi_g)
        pairs = self._fpk.basis.pairs(powers)
        terms = self._fpk.basis.terms(pairs)
        phi_g = self._quadrature(minds.density[:, 0], terms)
        hjb = self._hjb.step(minds.value, states, powers, phi_g)
        drift = self._hjb.drift(states, hjb.action)
        fpk = self._fpk.step(minds.density, states, pairs, terms[:, 1:], drift, hjb.curvature)
        return Outcome.of(Minds(hjb.weights, fpk.weights), hjb.action, hjb.residual, fpk.residual, phi_g)


class Learner(_Learner):
    """The same on weights (M, 246)."""

    def init(self, rows: int, plan: Floats) -> Floats:
        return super().init(rows, plan).models()

    def refit(self, weights: Floats, rows, known: Floats) -> Floats:
        m = self._minds(weights[rows])
        weights = weights.copy()
        weights[rows] = super().refit(m, known[rows]).models()
        return weights

    def step(self, weights: Floats, own: Floats, known: Floats | None):
        out = super().step(self._minds(weights), own, known)
        return out.minds.models(), out.numbers

    def _minds(self, weights):
        n = len(weights)
        return Minds(
            np.ascontiguousarray(weights[:, VALUE]).reshape(n, 2, -1),
            np.ascontiguousarray(weights[:, DENSITY]).reshape(n, 2, -1),
        )
