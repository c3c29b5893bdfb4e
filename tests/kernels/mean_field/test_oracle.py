"""The learners against exact derivatives worked out at fifty digits; closed forms of the sums of their features."""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.mean_field.learner import DENSITY_EXPONENTS, VALUE_EXPONENTS, tables
from meanflock.kernels.mean_field import features, fpk, hjb, layout
from meanflock.kernels.mean_field.layout import Tables
from meanflock.swarm import state
from meanflock.swarm.scenario import load

ORACLE = json.loads((Path(__file__).parents[2] / "oracle" / "learner.json").read_text())
CASES = range(len(ORACLE["cases"]))
RTOL = 1e-9
KEYS = {  # of the scenario, with the names of the oracle
    **{
        "learner.position_scale": "L_r",
        "learner.velocity_scale": "L_v",
        "learner.mu_h": "mu_H",
        "learner.mu_f": "mu_F",
    },
    **{"learner.c_h": "c_H", "learner.kappa": "kappa", "cost.c1": "c1", "cost.c2": "c2", "cost.c3": "c3"},
    **{"wind.sigma": "sigma_wind", "wind.drag": "c0", "wind.mean": "v_o", "destination.radius": "s_dest"},
}


@pytest.fixture(scope="module")
def t() -> Tables:
    return tables(load(None, [f"{key}={ORACLE['parameters'][name]}" for key, name in KEYS.items()]))


def rows(name: str) -> np.ndarray:
    return np.array([ORACLE["cases"][i][name] for i in CASES], dtype=float)


def close(actual: Any, name: str) -> None:
    np.testing.assert_allclose(actual, rows(name), rtol=RTOL, atol=0, err_msg=name)


def test_exponents_are_in_the_agreed_order() -> None:
    assert VALUE_EXPONENTS.tolist() == ORACLE["exponents_H"]
    assert DENSITY_EXPONENTS.tolist() == ORACLE["exponents_F"]


def weights(first: str, second: str) -> np.ndarray:
    return np.concatenate([rows(first), rows(second)], axis=-1)


def test_a_tick_of_either_form_under_the_oracle_s_interaction(t: Tables, backend: ModuleType) -> None:
    models = np.concatenate([weights("w_H0", "w_H1"), weights("w_F0", "w_F1")], axis=-1)
    stepped, numbers = np.empty_like(models), np.empty((len(CASES), 5))
    backend.learn(backend.prepare(t), rows("state"), models, rows("phi_G"), stepped, numbers)
    close(numbers[:, :2], "action_after")
    close(numbers[:, 2], "e_H")
    close(stepped[:, :54], "w_H0_next")
    close(stepped[:, 54:108], "w_H1_next")
    np.testing.assert_array_equal(numbers[:, 3], 0.0)
    np.testing.assert_array_equal(numbers[:, 4], rows("phi_G"))
    np.testing.assert_array_equal(stepped[:, layout.DENSITY], models[:, layout.DENSITY])


def test_density_features_and_step(t: Tables) -> None:
    states = rows("state")
    powers = features.powers(t, states)
    after = hjb.step(t, weights("w_H0", "w_H1"), states, powers, rows("phi_G"))
    close(hjb.lyapunov_rate(t, states, hjb.drift(t, states, after.action_before)), "L_s_dot")
    pairs = features.pairs(t, powers)
    sigma = features.terms(t, pairs)[:, 1:]
    close(sigma, "sigma_F")
    close(fpk.divergence(t, after.curvature), "drift_divergence")
    drift = hjb.drift(t, states, after.action)
    stepped, residual = fpk.step(t, weights("w_F0", "w_F1"), states, pairs, sigma, drift, after.curvature)
    close(residual, "e_F")
    close(stepped[:, :69], "w_F0_next")
    close(stepped[:, 69:], "w_F1_next")


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
