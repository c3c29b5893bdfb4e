"""One tick of mean-field learning: φ_G, value step, density step, action. State in, state out; all arrays are rows."""

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers.mean_field.density import fit
from meanflock.agent.controllers.mean_field.tables import tables
from meanflock.kernels import weights as layout
from meanflock.kernels.interaction import empirical
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats


class Learner:
    """Algorithm 1 (hjb) and the local part of Algorithms 2 and 3 (all others)."""

    def __init__(self, scenario: Scenario, *, learns_density: bool = True) -> None:
        self._scenario = scenario
        self._learns_density = learns_density
        self._of = tables(scenario)
        self._tables = kernels.prepare(self._of)

    def init(self, rows: int, initial_states: Floats) -> Floats:
        """Weights at take-off, `(rows, 246)`; every UAV fits one density to the initial states of all, `(N, 4)`."""
        weights = np.zeros((rows, layout.MODEL_FLOATS))
        if self._learns_density:
            weights[:, layout.DENSITY] = fit(self._scenario, self._of, initial_states)
        return weights

    def refit(self, weights: Floats, rows: NDArray[np.intp], known: Floats) -> Floats:
        """The weights (M, 246), the density of some rows fitted anew to the states they know, `(M, N, 4)`."""
        refitted, first = weights.copy(), slice(layout.DENSITY.start, layout.DENSITY.start + layout.DENSITY_FEATURES)
        for row in rows.tolist():
            refitted[row, first] = fit(self._scenario, self._of, known[row])[: layout.DENSITY_FEATURES]
        return refitted

    def step(self, weights: Floats, states: Floats, known: Floats | None) -> tuple[Floats, Floats]:
        """One update of each network and the action that follows: weights (M, 246) after it, and numbers (M, 5),
        [a_x, a_y, e_H, e_F, φ_G].

        Args:
            weights: (M, 246). states: (M, 4). known: (M, N, 4), the states each row knows, for hjb only.
        """
        around, cost = None, self._scenario.cost
        if not self._learns_density:
            if known is None:
                raise ValueError("hjb needs the states its rows know")
            with np.errstate(over="ignore", invalid="ignore"):
                around = known if cost.beta == 1.0 else empirical(states, known, cost.epsilon, cost.beta)
        stepped, numbers = weights.copy(), np.empty((len(weights), layout.NUMBERS))
        kernels.learn(self._tables, states, stepped, around, stepped, numbers)
        return stepped, numbers
