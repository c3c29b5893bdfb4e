"""Features with the coefficients of the paper's powers: closed forms of their sums."""

import numpy as np

from meanflock.agent.controllers.mean_field.learner import tables
from meanflock.kernels.mean_field import features
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
