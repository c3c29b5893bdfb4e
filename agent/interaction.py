"""The interaction term φ_G: how differently the neighbourhood flies.

Where states are shared it is the paper's empirical mean over the states received; where a density is learned it is
a quadrature of m̂ over nodes that travel with the UAV.
"""

from math import factorial, prod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.basis import DENSITY_DEGREE, DENSITY_EXPONENTS, scales
from swarm import state
from swarm.scenario import Cost, Scenario

Floats = NDArray[np.float64]

_ROWS_AT_ONCE = 64  # 36 KB each, while they are summed


def kernel(velocity_difference: Floats, position_difference: Floats, cost: Cost) -> Floats:
    """K = ‖Δv‖²/(ε + ‖Δr‖²)^β of differences `(..., 2)`; `(...)`."""
    distance = cost.epsilon + state.dot(position_difference, position_difference)
    if cost.beta != 1.0:
        distance = distance**cost.beta
    return state.dot(velocity_difference, velocity_difference) / distance


def empirical(states: Floats, known: Floats, cost: Cost) -> Floats:
    """φ_G(s_i; s_−i), Eq. InterAction01: the mean of K over the states a UAV knows.

    Args:
        states: (..., 4). known: (..., N, 4), each UAV's own knowledge of all N, itself included.
    """
    difference = known - states[..., None, :]
    return kernel(difference[..., state.VELOCITY], difference[..., state.POSITION], cost).mean(axis=-1)


def standard_nodes() -> Floats:
    """The 64 scrambled-Sobol points of the standard normal in four dimensions, `(64, 4)`; a fixed table."""
    text = Path(__file__).with_name("nodes.csv").read_text(encoding="ascii")
    return np.array([[float(cell) for cell in line.split(",")] for line in text.splitlines()])


class Quadrature:
    """φ_G(s; m̂) = Σ ω_q K(s, s + δ_q), Eq. InterAction03, ω = max(m̂, 0) normalised over fixed offsets δ.

    K depends on δ alone, so it is computed once. m̂(s + δ) is a polynomial in δ whose coefficients are those of m̂
    re-expanded about s, exactly: c_n = Σ_r ŵ_{n+r} (n+r choose n) s̄^r = (1/n!) Σ_r (ŵ_{n+r} (n+r)!) (s̄^r / r!).
    That costs 494 products instead of evaluating 69 monomials at 64 nodes.
    """

    def __init__(self, scenario: Scenario) -> None:
        spread = scenario.density
        std = np.array([spread.node_position_std] * 2 + [spread.node_velocity_std] * 2)
        offsets = standard_nodes() * std
        self.kernel = kernel(offsets[:, state.VELOCITY], offsets[:, state.POSITION], scenario.cost)
        terms = np.concatenate([np.zeros((1, state.SIZE), dtype=np.intp), DENSITY_EXPONENTS])
        degree = terms.sum(axis=-1)
        together = np.add.outer(degree, degree)  # of n + r: a term of m̂ if it is one of the 69
        n, r = np.nonzero((together > 0) & (together <= DENSITY_DEGREE))
        place = (terms * (DENSITY_DEGREE + 1) ** np.arange(state.SIZE)[::-1]).sum(axis=-1)  # ascending, as terms are
        self.weight = np.searchsorted(place, place[n] + place[r]) - 1
        self.term = r
        self.starts = np.searchsorted(n, np.arange(len(terms) + 1))
        self.factorial = np.array([float(prod(map(factorial, term))) for term in terms.tolist()])
        scaled = offsets / scales(scenario.learner)
        monomials = (scaled[None, :, :] ** terms[:, None, :]).prod(axis=-1)
        self.monomials = np.ascontiguousarray(monomials / self.factorial[:, None])

    def density(self, weights: Floats, terms: Floats) -> Floats:
        """m̂ at the nodes about each state, `(..., 64)`; weights ŵ_F0 `(..., 69)`, terms [1, σ_F] there `(..., 70)`."""
        products = (weights * self.factorial[1:]).take(self.weight, axis=-1)
        products *= (terms / self.factorial).take(self.term, axis=-1)
        expansion = np.add.reduceat(products, self.starts[:-1], axis=-1).reshape(-1, len(self.monomials))
        # Term after term and not by a BLAS, whose order depends on the machine and on the number of rows.
        at_nodes = [
            np.add.reduce(expansion[start : start + _ROWS_AT_ONCE, :, None] * self.monomials, axis=-2)
            for start in range(0, len(expansion), _ROWS_AT_ONCE)
        ]
        return np.concatenate(at_nodes).reshape(*weights.shape[:-1], -1)

    def __call__(self, weights: Floats, terms: Floats) -> Floats:
        """φ_G, `(...)`; 0 where m̂ is nowhere positive."""
        mass = np.maximum(self.density(weights, terms), 0.0)
        return (mass * self.kernel).sum(axis=-1) / np.maximum(mass.sum(axis=-1), np.finfo(np.float64).tiny)
