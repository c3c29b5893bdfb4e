"""The density every UAV starts from: a fit of m̂ to the states all share before take-off.

The paper starts from a sum of Dirac impulses with ŵ_F0 = 0; F̂ is homogeneous in ŵ_F, so from zero nothing is ever
learned. Here ŵ_F0(0) is a ridge least-squares fit to a Gaussian mixture over the initial states.
"""

import numpy as np

from meanflock.kernels import Tables, features
from meanflock.kernels.weights import DENSITY_FEATURES
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator
from meanflock.swarm.state import Floats

_BLOCK = 2**17  # pairs of point and centre at a time: 8 MiB, however many UAVs there are


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


def fit(scenario: Scenario, of: Tables, initial_states: Floats) -> Floats:
    """[ŵ_F0(0), 0], `(138,)`: min mean (ŵᵀσ_F(s) − m(s))² + ridge ‖ŵ‖² over fixed sample points.

    Every UAV of a run computes the same bits: the sample points come from a seed all know, and the normal
    equations are summed without BLAS, whose order depends on the number of cores.

    Args:
        of: the scenario's. initial_states: (N, 4).
    """
    spread = scenario.density
    bandwidth = np.array([spread.position_bandwidth] * 2 + [spread.velocity_bandwidth] * 2)
    draw = generator(scenario.seed, "density-fit")
    chosen = draw.integers(len(initial_states), size=spread.near_samples)
    near = initial_states[chosen] + 2.0 * bandwidth * draw.standard_normal((spread.near_samples, 4))
    box = of.scale * draw.uniform(-1.0, 1.0, (spread.box_samples, 4))
    points = np.concatenate([near, box])
    sigma = features.terms(of, features.pairs(of, features.powers(of, points)))[:, 1:]
    target = mixture(points, initial_states, bandwidth)
    normal = np.einsum("sk,sl->kl", sigma, sigma) / len(points)
    right = np.einsum("sk,s->k", sigma, target) / len(points)
    weights = np.zeros(2 * DENSITY_FEATURES)
    weights[:DENSITY_FEATURES] = np.linalg.solve(normal + spread.ridge * np.eye(DENSITY_FEATURES), right)
    return weights
