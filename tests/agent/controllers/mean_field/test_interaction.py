"""φ_G: the quadrature against m̂ evaluated at every node, and the source of the nodes."""

from importlib.resources import files
from itertools import product

import numpy as np
import pytest
from scipy.stats import norm, qmc

from meanflock.agent.controllers.mean_field.learner import Learner
from meanflock.kernels.mean_field import layout
from meanflock.swarm import state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load

EXPONENTS = np.array([row for row in product(range(5), repeat=4) if 1 <= sum(row) <= 4])  # σ_F, lexicographic
NODES = np.loadtxt(str(files("meanflock.agent.controllers.mean_field") / "nodes.csv"), delimiter=",")


def direct(flown: Scenario, weights: np.ndarray, at: np.ndarray) -> float:
    """Σ ω_q K(s, s + δ_q) with m̂ evaluated term by term at every node."""
    spread, learner = flown.density, flown.learner
    std = np.array([spread.node_position_std] * 2 + [spread.node_velocity_std] * 2)
    scale = np.array([learner.position_scale] * 2 + [learner.velocity_scale] * 2)
    offsets = NODES * std
    points = (at + offsets) / scale
    mass = np.maximum([weights @ np.prod(point**EXPONENTS, axis=1) for point in points], 0.0)
    squared = offsets**2
    kernel = squared[:, 2:].sum(axis=1) / (flown.cost.epsilon + squared[:, :2].sum(axis=1)) ** flown.cost.beta
    return float(mass @ kernel / mass.sum()) if mass.sum() > 0 else 0.0


def test_the_nodes_are_the_scrambled_sobol_points_they_are_said_to_be() -> None:
    sobol = qmc.Sobol(d=4, scramble=True, rng=np.random.default_rng(20200309)).random(64)
    np.testing.assert_allclose(NODES, norm.ppf(sobol), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("cost.epsilon=2.5", "cost.beta=0.5"),
        ("cost.beta=0",),
        ("density.node_position_std=30", "density.node_velocity_std=4"),
        ("learner.position_scale=150", "learner.velocity_scale=10"),
    ],
)
def test_the_quadrature_is_the_density_evaluated_at_every_node(settings: tuple[str, ...]) -> None:
    flown, draw, rows = load(None, ["uavs=9", "method=mfg", *settings]), np.random.default_rng(1), 12
    learner = Learner(flown)
    weights = learner.init(rows, starts(flown))
    states = draw.uniform([-150, -150, -9, -9], [160, 110, 9, 9], (rows, state.SIZE))
    states[0] = 0.0
    for _ in range(3):
        densities = weights[:, layout.DENSITY][:, : layout.DENSITY_FEATURES]
        expected = [direct(flown, w, s) for w, s in zip(densities, states, strict=True)]
        weights, numbers = learner.step(weights, states, None)
        np.testing.assert_allclose(numbers[:, 4], expected, rtol=1e-9, atol=1e-12)
        states = states + draw.normal(0, 1, states.shape)
    assert np.ptp(expected) > 0


@pytest.mark.parametrize("beta", [1.0, 0.5])
def test_with_hjb_phi_g_is_the_mean_over_the_states_a_uav_knows(beta: float) -> None:
    draw = np.random.default_rng(3)
    learner = Learner(load(None, ["uavs=4", f"cost.beta={beta}"], method="hjb"), learns_density=False)
    states, known = draw.normal(0, 5, (2, 4)), draw.normal(0, 5, (2, 4, 4))
    apart = known - states[:, None]
    kernel = (apart[..., 2:] ** 2).sum(axis=-1) / (1 + (apart[..., :2] ** 2).sum(axis=-1)) ** beta
    phi_g = learner.step(learner.init(2, known[0]), states, known)[1][:, 4]
    np.testing.assert_allclose(phi_g, kernel.mean(axis=-1), rtol=1e-12)
