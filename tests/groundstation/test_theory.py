"""Known exact answers against the code that flies: LMS moments, LQ control, Gaussians, the best flight."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy import integrate, linalg, optimize

from meanflock.agent.controllers.mean_field.tables import tables
from meanflock.groundstation.engine import Engine
from meanflock.groundstation.paper import optimum, theory
from meanflock.groundstation.paper.measure import LONG_S, filter_moments, long_flight, measure, measured
from meanflock.groundstation.paper.view import keep_measured
from meanflock.kernels import features, fpk, hjb
from meanflock.kernels.hjb import local_cost
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.vehicles.point_mass import PointMass
from tests.groundstation import exact


def moved(flown: Scenario, states: np.ndarray, command: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """One tick of the point mass."""
    return PointMass(PointMass.Options(), flown).step(states, {}, command, noise)[0]


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, settings, **{"method": "mfg", **options})


# -- the density learner as an LMS filter ------------------------------------------------------------


def gradients(count: int = 4000) -> np.ndarray:
    """Of states spread over the box, so that many directions are excited."""
    draw = np.random.default_rng(1)
    states = draw.uniform(-1, 1, (count, 4)) * [200, 200, 20, 20]
    return theory.fpk_gradients(scenario(), states, np.zeros((count, 2)), np.zeros(count))


def test_gradient_is_the_one_the_learner_steps_along() -> None:
    plain = scenario()
    draw = np.random.default_rng(2)
    states, actions = draw.normal(size=(6, 4)) * [100, 100, 5, 5], draw.normal(size=(6, 2))
    curvature, weights = draw.normal(size=6), draw.normal(size=(6, 138))
    t = tables(plain)
    pairs = features.pairs(t, features.powers(t, states))
    drift = actions - plain.wind.drag * (states[:, 2:] - np.array(plain.wind.mean))
    stepped, residual = fpk.step(t, weights, states, pairs, features.terms(t, pairs)[:, 1:], drift, curvature)
    g = theory.fpk_gradients(plain, states, actions, curvature)
    error = (g * weights).sum(axis=-1)
    assert residual == pytest.approx(error)
    assert stepped == pytest.approx(weights - plain.learner.mu_f * error[:, None] * g)


def test_mean_of_the_weights_decays_as_the_recursion_says() -> None:
    g = gradients()[:, :12] * 3
    r, start = theory.correlation(g), np.ones(12)
    mu, steps = 0.01 * theory.step_bound(r), 400
    simulated = theory.simulate_lms(g, start, mu, 0.1, steps, 3000, seed=3)
    expected = exact.mean_deviation(r, start, mu, steps)
    standard_error = simulated.std(axis=0) / math.sqrt(3000)
    assert np.abs(simulated.mean(axis=0) - expected).max() < 4.5 * standard_error.max()
    assert np.linalg.norm(expected) < 0.9 * np.linalg.norm(start)


def test_mean_square_deviation_is_the_closed_form_for_small_steps_only() -> None:
    g = gradients()[:, :12] * 3
    r, start = theory.correlation(g), np.full(12, 0.2)

    def excess(relative_step: float, steps: int) -> float:
        mu = relative_step * theory.step_bound(r)
        simulated = (theory.simulate_lms(g, start, mu, 0.5, steps, 2000, seed=4) ** 2).sum(axis=-1)
        return float(simulated.mean()) / theory.mean_square_deviation(r, start, mu, 0.5, steps) - 1.0

    assert abs(excess(0.002, 50)) < 0.02
    assert abs(excess(0.002, 2000)) < 0.05
    assert excess(0.02, 2000) > 0.15  # the fourth moment of g, which the closed form leaves out


def test_steady_deviation_is_the_papers_kronecker_form_and_vanishes_with_the_step() -> None:
    r, start, noise = theory.correlation(gradients()[:, :6]), np.zeros(6), 0.3
    found = []
    for mu in (0.4, 0.04, 0.004):
        left = np.eye(6) - mu * r
        f = np.kron(left.T, left.T)
        printed = mu**2 * noise**2 * r.ravel() @ np.linalg.solve(np.eye(36) - f, np.eye(6).ravel())
        found.append(theory.mean_square_deviation(r, start, mu, noise, 10**7))
        assert found[-1] == pytest.approx(printed)
    assert found[0] > 9 * found[1] > 81 * found[2]


def test_above_the_bound_the_mean_diverges() -> None:
    r = theory.correlation(gradients()[:, :6])
    bound = theory.step_bound(r)
    start = np.linalg.eigh(r)[1][:, -1]
    assert np.linalg.norm(exact.mean_deviation(r, start, 1.01 * bound, 2000)) > 1e3
    assert np.linalg.norm(exact.mean_deviation(r, start, 0.99 * bound, 2000)) < 1e-3


def test_filter_moments_of_spread_states_meet_the_claim() -> None:
    states = np.random.default_rng(5).uniform(-1, 1, (3000, 4)) * [200, 200, 20, 20]
    found = filter_moments(scenario(), states, relative_step=0.02, repeats=150)
    assert found["step_over_bound"] < 1
    assert found["bias"] < 0.2
    assert found["msd_ratio"] == pytest.approx(1.2, abs=0.2)  # a step too large for the closed form, but quick
    assert found["msd_fall"] < 0.6
    assert 0 < found["learnable"] < 138


# -- boundedness ------------------------------------------------------------


def test_growth_is_one_for_what_stays_and_more_for_what_grows() -> None:
    assert theory.growth(np.ones(300)) == 1.0
    assert theory.growth(np.linspace(1, 2, 300)) > 1.1
    assert theory.growth(np.exp(-np.linspace(0, 5, 300))) < 0.1


@pytest.mark.parametrize("method", ["hjb", "mfg"])
def test_long_flight_says_what_left_every_bound(method: str) -> None:
    calm = long_flight(scenario(method=method, uavs=4), 60.0)
    assert calm["lost"] == 0
    assert all(math.isfinite(value) for value in calm.values())
    wild = theory.fly_long(scenario("learner.mu_h=1e4", method=method, uavs=4), 60.0)
    assert wild.lost == 4
    assert math.isinf(wild.state[-1])
    assert LONG_S > 1000


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_the_radio_of_long_flights_loses_nothing(method: str) -> None:
    far = scenario("start.spacing=200", "federation.period=20", method=method, uavs=4)
    radio = Engine(theory.clear(far, 20.0), "clear").complete()["radio"]
    assert radio["outages"] == 0
    assert radio["sent"] == 199 * 4 * 3 if method == "hjb" else radio["sent"] > 0


# -- the control law where the problem is linear-quadratic ------------------------------------------------------------


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


# -- the best flight ------------------------------------------------------------

START = np.array([150.0, 100.0, 0.0, 0.0])


@pytest.mark.parametrize("ticks", [20, 100, 600])
def test_best_flight_is_what_a_solver_finds(ticks: int) -> None:
    problem = optimum.transcribe(Scenario(), START, ticks)
    shape = problem.linear.shape

    def objective(flat: np.ndarray) -> tuple[float, np.ndarray]:
        u = flat.reshape(shape)
        last = problem.coast + problem.end @ u
        smooth = math.sqrt(float(last @ last) + 1e-6)
        gradient = u + problem.linear + np.outer(problem.end, last / smooth)
        return problem.cost(u) - float(np.linalg.norm(last)) + smooth, gradient.ravel()

    options = {"maxiter": 20000, "maxfun": 50000, "ftol": 1e-14, "gtol": 1e-9}
    found = optimize.minimize(objective, np.zeros(shape[0] * 2), jac=True, method="L-BFGS-B", options=options)
    assert optimum.best_flight(Scenario(), START, ticks).cost == pytest.approx(found.fun, rel=1e-3)


def test_best_flight_obeys_the_worlds_dynamics_and_costs_what_it_says() -> None:
    plain = Scenario()
    best = optimum.best_flight(plain, START, 400)
    states = [START]
    for command in best.accelerations:
        states.append(moved(plain, states[-1], command, np.zeros(2)))
    assert np.array(states) == pytest.approx(best.states, abs=1e-9)
    assert float(optimum.flight_cost(plain, np.array(states), best.accelerations)) == pytest.approx(best.cost)


def test_no_disturbed_flight_is_cheaper() -> None:
    plain, draw = Scenario(), np.random.default_rng(12)
    best = optimum.best_flight(plain, START, 300)
    for size in (1e-3, 0.1, 1.0):
        smooth = size * np.cumsum(draw.standard_normal((300, 2)), axis=0) / 17
        states = [START]
        for command in best.accelerations + smooth:
            states.append(moved(plain, states[-1], command, np.zeros(2)))
        assert optimum.flight_cost(plain, np.array(states), best.accelerations + smooth) > best.cost


def test_far_from_home_the_best_flight_is_the_riccati_solution() -> None:
    drag, c1, c3, wind = 0.1, 0.015, 0.005, 1.0

    def rates(_: float, y: np.ndarray) -> list[float]:
        q, p, _ = y
        return [
            c1 - 2 * drag * q - q * q / c3,
            1 - drag * p + 2 * drag * wind * q - q * p / c3,
            drag * wind * p - p * p / (4 * c3),
        ]

    exact = float(integrate.solve_ivp(rates, (0, 4), [0, 0, 0], rtol=1e-11, atol=1e-12).y[2, -1])
    far = np.array([1e4, 0.0, 0.0, 0.0])
    errors = []
    for dt in (0.1, 0.05, 0.025):
        fine = scenario("wind.mean=[1.0, 0.0]", f"dt={dt}")
        errors.append(optimum.best_flight(fine, far, round(4 / dt)).cost - 1e4 - exact)
    assert abs(errors[-1]) < 0.3
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.15)  # first order in dt
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.15)


def test_gap_of_the_best_flight_is_one_and_of_any_other_more() -> None:
    plain = Scenario()
    best = optimum.best_flight(plain, START, 200)
    nothing = optimum.coast(plain, START, 200)
    states = np.stack([best.states, nothing], axis=1)
    commands = np.stack([best.accelerations, np.zeros((200, 2))], axis=1)
    gaps = optimum.gaps(plain, states, commands, np.array([200, -1]))
    assert gaps[0] == pytest.approx(1.0)
    assert gaps[1] > 1.5
    moving = optimum.gaps(plain, states, commands, np.array([200, -1]), moving=True)
    left = np.linalg.norm(states[-1, :, :2], axis=-1)
    np.testing.assert_allclose(gaps - moving, left / np.array([best.cost, best.cost]), rtol=1e-9, atol=1e-12)


def test_what_is_measured_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[int, int]] = []
    monkeypatch.setattr("meanflock.groundstation.paper.measure.filter_moments", partial(filter_moments, repeats=20))
    plain = scenario(uavs=3, duration=10.0)
    found = measure([1, 2], 10.0, plain, jobs=1, progress=lambda done, total: told.append((done, total)))
    assert told == [(0, 2), (1, 2), (2, 2)]
    assert {len(values) for values in found.values()} == {2}
    assert found["gap_hjb"][0] >= 1.0
    keep_measured(tmp_path, found, range(1, 9), LONG_S)
    assert measured(tmp_path) == found
