"""Features with the coefficients of the paper's powers: closed forms of their sums."""

import numpy as np

from meanflock.agent.controllers.mean_field.learner import tables
from meanflock.kernels.mean_field import features, fpk
from meanflock.swarm import state
from meanflock.swarm.scenario import load

SCALES = ["learner.position_scale=300", "learner.velocity_scale=60"]
PRINTED = load(None, ["uavs=9", "learner.multinomial=true", *SCALES], method="mfg")
T = tables(PRINTED)
STATES = np.random.default_rng(2).uniform([-50, -50, -8, -8], [180, 130, 8, 8], (13, state.SIZE))
SCALED = STATES / [300.0, 300.0, 60.0, 60.0]


def test_the_value_s_features_of_an_axis_add_up_to_the_sixth_power() -> None:
    """(1 + r̄ + v̄)⁶ − 1, and its derivatives by r, v and v twice."""
    of = features.value(T, features.powers(T, STATES)).sum(axis=-1)  # (13, 4, 2)
    base = 1.0 + SCALED[:, state.POSITION] + SCALED[:, state.VELOCITY]
    for k, expected in enumerate((base**6 - 1.0, 6 * base**5 / 300, 6 * base**5 / 60, 30 * base**4 / 60**2)):
        np.testing.assert_allclose(of[:, k], expected, rtol=1e-12)


def test_the_density_s_terms_add_up_to_the_fourth_power() -> None:
    of = features.terms(T, features.pairs(T, features.powers(T, STATES)))
    np.testing.assert_allclose(of.sum(axis=-1), (1.0 + SCALED.sum(axis=-1)) ** 4, rtol=1e-12)


def test_the_operator_of_the_fpk_equation_acts_on_that_power() -> None:
    """σ∇·b + bᵀ∇σ − ½tr(GGᵀ Hess σ) of (1 + Σs̄)⁴ − 1, whose gradient is 4(…)³/L and whose Hessian 12(…)²/L²."""
    draw = np.random.default_rng(3)
    drift, divergence = draw.normal(size=(13, 4)), draw.normal(size=13)
    pairs = features.pairs(T, features.powers(T, STATES))
    base, inverse = 1.0 + SCALED.sum(axis=-1), 1.0 / np.array([300.0, 300.0, 60.0, 60.0])
    expected = (
        (base**4 - 1.0) * divergence
        + 4 * base**3 * (drift * inverse).sum(axis=-1)
        - T.half_variance * 12 * base**2 * 2 / 60**2
    )
    np.testing.assert_allclose(fpk.operator(T, pairs, drift, divergence).sum(axis=-1), expected, rtol=1e-9, atol=1e-12)
