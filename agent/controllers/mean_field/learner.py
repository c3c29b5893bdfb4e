"""The two networks of a mean-field method: their initial weights, and one step. All arrays are rows.

The paper starts the density from a sum of Dirac impulses with ŵ_F0 = 0. F̂ is homogeneous in ŵ_F, so a learner that
starts at zero never learns. Here ŵ_F0(0) is a ridge least-squares fit of m̂ to a Gaussian mixture over the initial
states, which all UAVs know before take-off.
"""

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers.mean_field.tables import tables
from meanflock.kernels.mean_field import features
from meanflock.kernels.mean_field.interaction import empirical
from meanflock.kernels.mean_field.layout import DENSITY, DENSITY_FEATURES, MODEL_FLOATS, NUMBERS, Tables
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator
from meanflock.swarm.state import Floats

_BLOCK = 2**17  # pairs of point and centre at a time; bounds the memory at 8 MiB


class Learner:
    """Algorithm 1 (hjb) and the local part of Algorithms 2 and 3 (all others)."""

    def __init__(self, scenario: Scenario, *, learns_density: bool = True) -> None:
        self._scenario = scenario
        self._learns_density = learns_density
        self._constants = tables(scenario)
        self._prepared = kernels.prepare(self._constants)

    def init(self, rows: int, initial_states: Floats) -> Floats:
        """Weights at take-off, `(rows, 246)`; every UAV fits one density to the initial states of all, `(N, 4)`."""
        weights = np.zeros((rows, MODEL_FLOATS))
        if self._learns_density:
            weights[:, DENSITY] = fit(self._scenario, self._constants, initial_states)
        return weights

    def refit(self, weights: Floats, rows: NDArray[np.intp], known: Floats) -> Floats:
        """The weights (M, 246), with the density of some rows fitted to the states `known` to them, `(M, N, 4)`."""
        refitted, first = weights.copy(), slice(DENSITY.start, DENSITY.start + DENSITY_FEATURES)
        for row in rows.tolist():
            refitted[row, first] = fit(self._scenario, self._constants, known[row])[:DENSITY_FEATURES]
        return refitted

    def step(self, weights: Floats, states: Floats, known: Floats | None) -> tuple[Floats, Floats]:
        """Update each network once; returns the new weights (M, 246), and numbers (M, 5), [a_x, a_y, e_H, e_F, φ_G].

        Args:
            weights: (M, 246). states: (M, 4). known: (M, N, 4), the states known to each row, for hjb only.
        """
        around, cost = None, self._scenario.cost
        if not self._learns_density:
            if known is None:
                raise ValueError("hjb needs the states known to its rows")
            with np.errstate(over="ignore", invalid="ignore"):
                around = known if cost.beta == 1.0 else empirical(states, known, cost.epsilon, cost.beta)
        stepped, numbers = weights.copy(), np.empty((len(weights), NUMBERS))
        kernels.learn(self._prepared, states, stepped, around, stepped, numbers)
        return stepped, numbers


def mixture(points: Floats, centres: Floats, bandwidth: Floats) -> Floats:
    """Gaussian mixture over `centres` (N, 4) with std `bandwidth` (4,), its peak over the centres scaled to one.

    Args:
        points: (S, 4). Returns: (S,).
    """
    rows = max(1, _BLOCK // len(centres))

    def raw(at: Floats) -> Floats:
        sums = np.empty(len(at))
        for start in range(0, len(at), rows):
            z = (at[start : start + rows, None, :] - centres[None, :, :]) / bandwidth
            sums[start : start + rows] = np.exp(-0.5 * (z * z).sum(axis=-1)).sum(axis=-1)
        return sums

    return raw(points) / raw(centres).max()


def fit(scenario: Scenario, constants: Tables, initial_states: Floats) -> Floats:
    """[ŵ_F0(0), 0], `(138,)`: min mean (ŵᵀσ_F(s) − m(s))² + ridge ‖ŵ‖² over fixed sample points.

    Every UAV of a run computes the same bits: the sample points come from the scenario's seed, and the normal
    equations are summed without BLAS, whose order depends on the number of cores.

    Args:
        constants: of the scenario. initial_states: (N, 4).
    """
    spread = scenario.density
    bandwidth = np.array([spread.position_bandwidth] * 2 + [spread.velocity_bandwidth] * 2)
    draw = generator(scenario.seed, "density-fit")
    chosen = draw.integers(len(initial_states), size=spread.near_samples)
    near = initial_states[chosen] + 2.0 * bandwidth * draw.standard_normal((spread.near_samples, 4))
    box = constants.scale * draw.uniform(-1.0, 1.0, (spread.box_samples, 4))
    points = np.concatenate([near, box])
    sigma = features.terms(constants, features.pairs(constants, features.powers(constants, points)))[:, 1:]
    target = mixture(points, initial_states, bandwidth)
    normal = np.einsum("sk,sl->kl", sigma, sigma) / len(points)
    right = np.einsum("sk,s->k", sigma, target) / len(points)
    weights = np.zeros(2 * DENSITY_FEATURES)
    weights[:DENSITY_FEATURES] = np.linalg.solve(normal + spread.ridge * np.eye(DENSITY_FEATURES), right)
    return weights
