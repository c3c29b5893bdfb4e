"""The learners' tick, compiled. Where no compiler was at hand when meanflock was installed, it is NumPy's.

Both give the same bits. One call for all the rows of a process takes the place of some eighty of NumPy's, each of
which finds its code and its data gone from the caches when twenty-five processes take turns on a core.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from agent.basis import scales
from agent.fpk import FpkLearner
from agent.hjb import HjbLearner
from agent.interaction import Quadrature
from agent.minds import Minds, Outcome
from swarm.messages import OUTCOME_FLOATS
from swarm.model import BEYOND_SENSE
from swarm.plain import Template
from swarm.scenario import Scenario

try:
    from agent import _kernel
except ImportError:
    _kernel = None  # type: ignore[assignment]

Floats = NDArray[np.float64]
Kinds: TypeAlias = tuple[tuple[Template, Template], ...]  # of Senses, and of the Acts that answer them
Answer: TypeAlias = Callable[[bytes, int, int, bytes], bytes | None]

# Gaps of a template, as in agent/message.h: states (M, 4), models as they travel (S, …), outcome (M, 5), whose the
# models are (S,), and what was learned (M, 246).
STATES, MODELS, OUTCOME, SOURCE, REPORT = range(2, 7)


def is_compiled() -> bool:
    """Whether this installation has the compiled form."""
    return _kernel is not None


class Kernel:
    """One tick of M rows: what `Learner.step` says, value and density step together."""

    @staticmethod
    def serves(scenario: Scenario) -> bool:
        """Whether there is a compiled form for this scenario: an exponent β other than one is left to NumPy."""
        return is_compiled() and (scenario.method.learns_density or scenario.cost.beta == 1.0)

    def __init__(self, scenario: Scenario, hjb: HjbLearner, fpk: FpkLearner, quadrature: Quadrature) -> None:
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
            "learns_density": scenario.method.learns_density,
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

    def sides(self, here: Minds, there: Minds) -> Any:
        """Where `Turn` finds minds and leaves them: `side` 0 is here, where they are now. It holds on to the arrays."""
        return _kernel.Sides(self._tables, BEYOND_SENSE, here.value, here.density, there.value, there.density)

    @staticmethod
    def turn(sides: Any, kinds: Kinds, *models: Any) -> Answer:
        """From a plain Sense of a tick and of one of these kinds to the Act, the minds then being on the other side.

        `models`, as far as any travel: how many; of each the first float, where they end, the bytes of a float, and
        what one that is uploaded is below; and what all rows are called, where some upload. The answer is asked for
        with the bytes, the tick, the number of the round, and the places of the rows that upload, (S,) intp, as bytes.
        It is None, and nothing has changed, where the bytes are no such Sense, not finite or of other rows; where a
        number that came out is not below `BEYOND_SENSE`; or where a model is beyond what can be uploaded.
        """
        return _kernel.Turn(sides, kinds, *models).answer

    def __call__(self, minds: Minds, states: Floats, known: Floats | None) -> Outcome:
        """One tick of M rows; `known` (M, N, 4) for hjb only."""
        value, density = np.ascontiguousarray(minds.value), np.ascontiguousarray(minds.density)
        stepped, numbers = np.empty_like(value), np.empty((len(value), OUTCOME_FLOATS))
        moved = np.empty_like(density) if known is None else density
        states = np.ascontiguousarray(states)
        largest = _kernel.step(self._tables, states, value, density, known, stepped, moved, numbers)
        return Outcome(Minds(stepped, moved), numbers, largest)
