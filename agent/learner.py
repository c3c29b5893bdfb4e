"""One tick of mean-field learning: φ_G, value step, density step, action. State in, state out; all arrays are rows."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import kernels
from agent.density import fit
from agent.tables import tables
from kernels.interaction import empirical
from swarm import model
from swarm.messages import OUTCOME_FLOATS
from swarm.scenario import Scenario

Floats = NDArray[np.float64]


class StepResult(NamedTuple):
    """One tick of M rows.

    weights: (M, 246) after it. numbers: (M, 5), [a_x, a_y, e_H, e_F, φ_G]. largest: of |numbers|, NaN where one is.
    """

    weights: Floats
    numbers: Floats
    largest: float


class Learner:
    """Algorithm 1 (hjb) and the local part of Algorithms 2 and 3 (all others)."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._learns_density = scenario.method.learns_density
        self._of = tables(scenario)
        self._tables = kernels.prepare(self._of)

    def init(self, rows: int, initial_states: Floats) -> Floats:
        """Weights at take-off, `(rows, 246)`; every UAV fits one density to the initial states of all, `(N, 4)`."""
        weights = np.zeros((rows, model.MODEL_FLOATS))
        if self._learns_density:
            weights[:, model.DENSITY] = fit(self._scenario, self._of, initial_states)
        return weights

    def refit(self, weights: Floats, known: Floats) -> Floats:
        """The weights of M rows, the density of each fitted anew to the states it knows, `(M, N, 4)`."""
        refitted, first = weights.copy(), slice(model.DENSITY.start, model.DENSITY.start + model.DENSITY_FEATURES)
        for row, states in enumerate(known):
            refitted[row, first] = fit(self._scenario, self._of, states)[: model.DENSITY_FEATURES]
        return refitted

    def step(self, weights: Floats, states: Floats, known: Floats | None) -> StepResult:
        """One update of each network and the action that follows.

        Args:
            weights: (M, 246). states: (M, 4). known: (M, N, 4), the states each row knows, for hjb only.
        """
        around, cost = None, self._scenario.cost
        if not self._learns_density:
            if known is None:
                raise ValueError("hjb needs the states its rows know")
            with np.errstate(over="ignore", invalid="ignore"):
                around = known if cost.beta == 1.0 else empirical(states, known, cost.epsilon, cost.beta)
        weights, states = np.ascontiguousarray(weights), np.ascontiguousarray(states)
        stepped, numbers = np.empty_like(weights), np.empty((len(weights), OUTCOME_FLOATS))
        largest = kernels.learn(self._tables, states, weights, around, stepped, numbers)
        return StepResult(stepped, numbers, largest)
