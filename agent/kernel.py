"""The learners' tick, compiled. Where no compiler was at hand when meanflock was installed, it is NumPy's.

Both give the same bits. One call for all the rows of a process takes the place of some eighty of NumPy's, each of
which finds its code and its data gone from the caches when twenty-five processes take turns on a core.
"""

import numpy as np
from numpy.typing import NDArray

from agent.basis import scales
from agent.fpk import FpkLearner
from agent.hjb import HjbLearner
from agent.interaction import Quadrature
from agent.minds import Minds, Outcome

OUTCOME_FLOATS = 5
from swarm.scenario import Scenario

try:
    from agent import _kernel
except ImportError:
    _kernel = None  # type: ignore[assignment]

Floats = NDArray[np.float64]


def is_compiled() -> bool:
    """Whether this installation has the compiled form."""
    return _kernel is not None


class Kernel:
    """One tick of M rows: what `Learner.step` says, value and density step together."""

    @staticmethod
    def serves(scenario: Scenario, learns_density: bool) -> bool:
        """Whether there is a compiled form for this scenario: an exponent β other than one is left to NumPy."""
        return is_compiled() and (learns_density or scenario.cost.beta == 1.0)

    def __init__(
        self, scenario: Scenario, learns_density: bool, hjb: HjbLearner, fpk: FpkLearner, quadrature: Quadrature
    ) -> None:
        learner, cost = scenario.learner, scenario.cost
        value, density = hjb.basis, fpk.basis
        doubles = {
            "scale": scales(learner),
            "value_factor": value.factor,
            "pair_factor": density.factor,
            "factorial": quadrature.factorial,
            "monomials": quadrature.monomials,
            "kernel": quadrature.kernel,
            "wind": hjb.wind,
            "c1": cost.c1,
            "c2": cost.c2,
            "c3": cost.c3,
            "epsilon": cost.epsilon,
            "mu_h": learner.mu_h,
            "mu_f": learner.mu_f,
            "push": hjb.push,
            "kappa": learner.kappa,
            "drag": scenario.wind.drag,
            "half_variance": hjb.half_variance,
            "gain": hjb.gain,
            "arrived_squared": hjb.arrived_squared,
            "learns_density": learns_density,
        }
        indices = {
            "value_first": value.first,
            "value_second": value.second,
            "pair_first": density.first,
            "pair_second": density.second,
            "at_position": density.at_position,
            "at_velocity": density.at_velocity,
            "left": density.left,
            "right": density.right,
            "weight": quadrature.weight,
            "term": quadrature.term,
            "starts": quadrature.starts,
        }
        self._tables = _kernel.tables(
            {name: np.ascontiguousarray(number, dtype=np.float64) for name, number in doubles.items()}
            | {name: np.ascontiguousarray(index, dtype=np.int32) for name, index in indices.items()}
        )

    def __call__(self, minds: Minds, states: Floats, known: Floats | None) -> Outcome:
        """One tick of M rows; `known` (M, N, 4) for hjb only."""
        value, density = np.ascontiguousarray(minds.value), np.ascontiguousarray(minds.density)
        stepped, numbers = np.empty_like(value), np.empty((len(value), OUTCOME_FLOATS))
        moved = np.empty_like(density) if known is None else density
        states = np.ascontiguousarray(states)
        largest = _kernel.step(self._tables, states, value, density, known, stepped, moved, numbers)
        return Outcome(Minds(stepped, moved), numbers, largest)
