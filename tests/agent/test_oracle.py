"""The learners against exact derivatives worked out at fifty digits, to 1e-9 relative."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.basis import DENSITY_EXPONENTS, VALUE_EXPONENTS, DensityBasis, Powers, ValueBasis
from agent.fpk import FpkLearner
from agent.hjb import HjbLearner, local_cost
from swarm import state
from swarm.scenario import Scenario, load

ORACLE = json.loads((Path(__file__).parents[1] / "oracle" / "learner.json").read_text())
CASES = range(len(ORACLE["cases"]))
RTOL = 1e-9


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    given = ORACLE["parameters"]
    return load(
        None,
        [
            f"learner.position_scale={given['L_r']}",
            f"learner.velocity_scale={given['L_v']}",
            f"learner.mu_h={given['mu_H']}",
            f"learner.mu_f={given['mu_F']}",
            f"learner.c_h={given['c_H']}",
            f"learner.kappa={given['kappa']}",
            f"cost.c1={given['c1']}",
            f"cost.c2={given['c2']}",
            f"cost.c3={given['c3']}",
            f"wind.sigma={given['sigma_wind']}",
            f"wind.drag={given['c0']}",
            f"wind.mean={given['v_o']}",
            f"destination.radius={given['s_dest']}",
        ],
    )


def rows(name: str) -> np.ndarray:
    return np.array([ORACLE["cases"][i][name] for i in CASES], dtype=float)


def close(actual: Any, name: str) -> None:
    np.testing.assert_allclose(actual, rows(name), rtol=RTOL, atol=0, err_msg=name)


def test_exponents_are_in_the_agreed_order() -> None:
    assert VALUE_EXPONENTS.tolist() == ORACLE["exponents_H"]
    assert DENSITY_EXPONENTS.tolist() == ORACLE["exponents_F"]


def test_value_features_and_derivatives(scenario: Scenario) -> None:
    powers = Powers(scenario.learner)(rows("state"))
    sigma, by_position, by_velocity, curvature = np.moveaxis(ValueBasis(scenario.learner)(powers), -3, 0)
    close(sigma.reshape(-1, 54), "sigma_H")
    gradient = np.zeros((len(CASES), 54, 4))
    for axis, part in enumerate((slice(0, 27), slice(27, 54))):
        gradient[:, part, axis] = by_position[:, axis]
        gradient[:, part, axis + state.VX] = by_velocity[:, axis]
    close(gradient, "grad_sigma_H")
    close(curvature.reshape(-1, 54), "velocity_laplacian_sigma_H")


def test_value_step(scenario: Scenario) -> None:
    learner = HjbLearner(scenario)
    states = rows("state")
    powers = Powers(scenario.learner)(states)
    weights = np.stack([rows("w_H0"), rows("w_H1")], axis=1)
    result = learner.step(weights, states, powers, rows("phi_G"))
    close(local_cost(states, scenario.cost.c1), "phi_L")
    close(result.action_before, "action_before")
    close(result.residual, "e_H")
    close(result.weights[:, 0], "w_H0_next")
    close(result.weights[:, 1], "w_H1_next")
    close(result.action, "action_after")
    close(learner.lyapunov_rate(states, learner.drift(states, result.action_before)), "L_s_dot")


def test_the_regulariser_is_active_where_it_should_be() -> None:
    active = [ORACLE["cases"][i]["regulariser_active"] for i in CASES]
    assert any(active)
    assert not all(active)


def test_density_features_and_step(scenario: Scenario) -> None:
    hjb, fpk = HjbLearner(scenario), FpkLearner(scenario)
    states = rows("state")
    powers = Powers(scenario.learner)(states)
    value = np.stack([rows("w_H0"), rows("w_H1")], axis=1)
    after = hjb.step(value, states, powers, rows("phi_G"))
    basis = DensityBasis(scenario.learner, scenario.wind.sigma)
    pairs = basis.pairs(powers)
    sigma = basis.terms(pairs)[:, 1:]
    close(sigma, "sigma_F")
    close(fpk.divergence(after.curvature), "drift_divergence")
    weights = np.stack([rows("w_F0"), rows("w_F1")], axis=1)
    drift = hjb.drift(states, after.action)
    result = fpk.step(weights, states, pairs, sigma, drift, after.curvature)
    close(result.residual, "e_F")
    close(result.weights[:, 0], "w_F0_next")
    close(result.weights[:, 1], "w_F1_next")
