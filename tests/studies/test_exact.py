"""Linear-quadratic control and exact Gaussians against the code that flies."""

import msgspec
import numpy as np
import pytest
from scipy import integrate, linalg

from meanflock.agent.controllers.mean_field.tables import tables
from meanflock.kernels.mean_field import features, hjb
from meanflock.kernels.mean_field.hjb import local_cost
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from tests.studies import exact
from tests.studies.plain import moved, scenario


def ask(plain: Scenario, weights: np.ndarray, states: np.ndarray) -> hjb.ValueStep:
    """What the learner's own step says at `states` with the same weights for all."""
    t, rows = tables(plain), len(states)
    flat = np.repeat(weights.reshape(1, -1), rows, axis=0)
    return hjb.step(t, flat, states, features.powers(t, states), np.zeros(rows))


def test_regulator_action_and_residual_are_exact() -> None:
    plain = scenario("wind.mean=[0.0, 0.0]", "cost.c1=0", "learner.mu_h=1e-12")
    q = np.diag([0.01, 0.02])
    p = exact.regulator(plain, q)
    states = np.random.default_rng(6).normal(size=(40, 4)) * [100, 100, 10, 10]
    found = ask(plain, exact.value_weights(plain, p, np.zeros(4)), states)
    gain = p[1] / plain.cost.c3
    expected = -(gain[0] * states[:, state.POSITION] + gain[1] * states[:, state.VELOCITY])
    assert found.action_before == pytest.approx(expected)
    quadratic = (states**2 * [0.01, 0.01, 0.02, 0.02]).sum(axis=-1)
    noise = plain.wind.sigma**2 * 2 * p[1, 1]
    residual = found.residual - local_cost(states, 0.0) + quadratic
    assert residual == pytest.approx(np.full(40, noise), abs=1e-9)
    closed = np.array([[0.0, 1.0], [-gain[0], -gain[1] - plain.wind.drag]])
    assert np.linalg.eigvals(closed).real.max() < 0


def test_cruise_solves_the_papers_own_problem_on_a_line() -> None:
    plain = scenario("wind.mean=[1.0, 0.0]", "learner.mu_h=1e-12")
    cruise = exact.cruise(plain)
    drag, c1, c3 = plain.wind.drag, plain.cost.c1, plain.cost.c3
    riccati = linalg.solve_continuous_are(np.array([[-drag]]), np.eye(1), np.array([[c1]]), np.array([[c3]]))
    assert cruise.q == pytest.approx(riccati[0, 0])
    draw = np.random.default_rng(7)
    states = np.zeros((40, 4))
    states[:, state.X], states[:, state.VX] = draw.uniform(10, 200, 40), draw.uniform(-30, 5, 40)
    weights = exact.value_weights(plain, np.diag([0.0, cruise.q]), np.array([0.0, 0.0, cruise.p, 0.0]))
    found = ask(plain, weights, states)
    across = plain.wind.sigma**2 * cruise.q  # the same q on the y axis, where only the noise is felt
    assert found.residual == pytest.approx(np.full(40, across - cruise.rate), abs=1e-9)
    law = -(2 * cruise.q * states[:, state.VX] + cruise.p) / (2 * c3)
    assert found.action_before[:, 0] == pytest.approx(law)


def test_cruise_speed_is_where_the_dynamics_settle_under_the_law() -> None:
    plain = scenario("wind.mean=[1.0, 0.0]", "wind.sigma=0")
    cruise = exact.cruise(plain)
    states = np.array([1e6, 0.0, 0.0, 0.0])
    for _ in range(400):
        law = -(2 * cruise.q * states[state.VX] + cruise.p) / (2 * plain.cost.c3)
        states = moved(plain, states, np.array([law, 0.0]), np.zeros(2))
    assert states[state.VX] == pytest.approx(cruise.speed)


# -- the FPK operator on an exact Gaussian ------------------------------------------------------------


def flow_of(sigma: float = 0.5) -> tuple[Scenario, exact.LinearFlow]:
    plain = scenario("wind.mean=[0.0, 0.0]", f"wind.sigma={sigma}")
    return plain, exact.closed_loop(plain, np.concatenate([0.3 * np.eye(2), 0.8 * np.eye(2)], axis=1))


def test_residual_of_the_exact_gaussian_is_zero_at_rest_and_in_motion() -> None:
    _, flow = flow_of()
    mean, covariance = exact.stationary(flow)
    draw = np.random.default_rng(8)
    states = draw.multivariate_normal(mean, covariance, 50)
    assert np.abs(exact.gaussian_residual(flow, mean, covariance, states)).max() < 1e-13
    moving = covariance + np.diag([9.0, 4.0, 1.0, 2.0])
    assert np.abs(exact.gaussian_residual(flow, mean + np.array([5, 3, -1, 1]), moving, states)).max() < 1e-13


def test_gaussian_follows_the_simulated_cloud() -> None:
    plain, flow = flow_of()
    gain = np.concatenate([0.3 * np.eye(2), 0.8 * np.eye(2)], axis=1)
    fine = msgspec.structs.replace(plain, dt=0.01)
    draw = np.random.default_rng(9)
    start_mean, start_std = np.array([5.0, -3.0, 1.0, 0.0]), np.array([1.0, 2.0, 0.5, 0.2])
    cloud = start_mean + start_std * draw.standard_normal((20000, 4))
    for _ in range(200):
        cloud = moved(fine, cloud, -cloud @ gain.T, draw.standard_normal((20000, 2)))

    def moments(_: float, y: np.ndarray) -> np.ndarray:
        covariance = y[4:].reshape(4, 4)
        rate = flow.matrix @ covariance + covariance @ flow.matrix.T + flow.diffusion
        return np.concatenate([flow.matrix @ y[:4] + flow.offset, rate.ravel()])

    end = integrate.solve_ivp(moments, (0, 2), np.concatenate([start_mean, np.diag(start_std**2).ravel()]), rtol=1e-8)
    assert cloud.mean(axis=0) == pytest.approx(end.y[:4, -1], abs=0.06)
    assert np.cov(cloud.T) == pytest.approx(end.y[4:, -1].reshape(4, 4), abs=0.08)


def test_operator_of_the_learner_vanishes_on_the_expanded_gaussian_to_fourth_order() -> None:
    plain, flow = flow_of()
    mean, covariance = exact.stationary(flow)
    weights = exact.gaussian_weights(plain, covariance)
    directions = np.random.default_rng(10).multivariate_normal(mean, covariance, 40)
    radii = 0.25 * 0.5 ** np.arange(4)
    worst = [np.abs(exact.operator_residual(plain, flow, weights, radius * directions)).max() for radius in radii]
    order = np.polyfit(np.log(radii), np.log(worst), 1)[0]
    assert order == pytest.approx(4.0, abs=0.05)  # σ_F ends at degree four; two derivatives cost two of six


def test_operator_misses_a_gaussian_that_is_not_stationary() -> None:
    plain, flow = flow_of()
    _, covariance = exact.stationary(flow)
    weights = exact.gaussian_weights(plain, 2 * covariance)
    assert abs(exact.operator_residual(plain, flow, weights, np.zeros((1, 4)))[0]) > 0.1
    t = tables(plain)
    assert features.terms(t, features.pairs(t, features.powers(t, np.zeros((1, 4))))).shape == (1, 70)
