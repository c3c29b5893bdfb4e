"""One tick of a UAV's mind: φ_G, value step, density step, action. State in, state out; all arrays are rows."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent import interaction
from agent.basis import Powers
from agent.density import fit
from agent.fpk import FpkLearner
from agent.hjb import HjbLearner
from agent.kernel import Kernel
from swarm import model, state
from swarm.messages import OUTCOME_FLOATS
from swarm.scenario import Scenario

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Minds:
    """What M UAVs have learned: value (M, 2, 54), density (M, 2, 69)."""

    value: Floats
    density: Floats

    def models(self) -> Floats:
        """Whole models in the order of the radio, `(M, 246)`."""
        rows = len(self.value)
        return np.concatenate([self.value.reshape(rows, -1), self.density.reshape(rows, -1)], axis=-1)

    def with_models(self, rows: NDArray[np.intp], part: slice, vectors: Floats) -> "Minds":
        """The same minds, the `part` of the models of `rows` overwritten by `vectors` (len(rows), L)."""
        models = self.models()
        models[rows, part] = vectors
        return Minds(
            models[:, model.VALUE].reshape(self.value.shape),
            models[:, model.DENSITY].reshape(self.density.shape),
        )


@dataclass(frozen=True, slots=True)
class Outcome:
    """One tick: minds after it, and the rows [a_x, a_y, e_H, e_F, φ_G] of an Act, (M, 5)."""

    minds: Minds
    numbers: Floats

    @classmethod
    def of(cls, minds: Minds, accelerations: Floats, *diagnostics: Floats) -> "Outcome":
        """Puts the columns together: accelerations (M, 2), then e_H, e_F, φ_G, each (M,); zeros where left out."""
        numbers = np.zeros((len(accelerations), OUTCOME_FLOATS))
        numbers[:, : state.AXES] = accelerations
        for column, values in enumerate(diagnostics, state.AXES):
            numbers[:, column] = values
        return cls(minds, numbers)

    @property
    def accelerations(self) -> Floats:
        """(M, 2), m/s²."""
        return self.numbers[:, : state.AXES]

    @property
    def hjb_residual(self) -> Floats:
        """e_H, (M,)."""
        return self.numbers[:, state.AXES]

    @property
    def fpk_residual(self) -> Floats:
        """e_F, (M,)."""
        return self.numbers[:, state.AXES + 1]

    @property
    def phi_g(self) -> Floats:
        """φ_G, (M,)."""
        return self.numbers[:, state.AXES + 2]


class Learner:
    """Algorithm 1 (hjb) and the local part of Algorithms 2 and 3 (all others)."""

    def __init__(self, scenario: Scenario, *, compiled: bool = True) -> None:
        """`compiled`: with the compiled kernel, if this installation has it; the bits are the same."""
        self._scenario = scenario
        self._powers = Powers(scenario.learner)
        self._hjb = HjbLearner(scenario)
        self._fpk = FpkLearner(scenario)
        self._quadrature = interaction.Quadrature(scenario)
        self._kernel: Kernel | None = None
        if compiled and Kernel.serves(scenario):
            self._kernel = Kernel(scenario, self._hjb, self._fpk, self._quadrature)

    def init(self, rows: int, initial_states: Floats) -> Minds:
        """Minds at take-off; every UAV fits the same density to the initial states of all, `(N, 4)`."""
        value = self._hjb.init(rows)
        if not self._scenario.method.learns_density:
            return Minds(value, np.zeros((rows, 2, model.DENSITY_FEATURES)))
        return Minds(value, np.repeat(fit(self._scenario, initial_states)[None], rows, axis=0))

    def refit(self, minds: Minds, known: Floats) -> Minds:
        """Fits the density of every row anew to the states it knows, `(M, N, 4)`."""
        fitted = np.stack([fit(self._scenario, states) for states in known])
        return replace(minds, density=np.stack([fitted[:, 0], minds.density[:, 1]], axis=1))

    def step(self, minds: Minds, states: Floats, known: Floats | None) -> Outcome:
        """One update of each network and the action that follows.

        Args:
            states: (M, 4). known: (M, N, 4), the states each row knows, for hjb; None for the others.
        """
        learns_density = self._scenario.method.learns_density
        if not learns_density and known is None:
            raise ValueError("hjb needs the states its rows know")
        if self._kernel is not None:
            value, density, numbers = self._kernel(
                minds.value, minds.density, states, None if learns_density else known
            )
            return Outcome(Minds(value, density), numbers)
        powers = self._powers(states)
        if known is not None and not learns_density:
            phi_g = interaction.empirical(states, known, self._scenario.cost)
            hjb = self._hjb.step(minds.value, states, powers, phi_g)
            minds = replace(minds, value=hjb.weights)
            return Outcome.of(minds, hjb.action, hjb.residual, np.zeros_like(phi_g), phi_g)
        pairs = self._fpk.basis.pairs(powers)
        terms = self._fpk.basis.terms(pairs)
        phi_g = self._quadrature(minds.density[:, 0], terms)
        hjb = self._hjb.step(minds.value, states, powers, phi_g)
        drift = self._hjb.drift(states, hjb.action)
        fpk = self._fpk.step(minds.density, states, pairs, terms[:, 1:], drift, hjb.curvature)
        return Outcome.of(Minds(hjb.weights, fpk.weights), hjb.action, hjb.residual, fpk.residual, phi_g)
