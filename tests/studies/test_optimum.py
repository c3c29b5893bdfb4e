"""The best flight there is, against a solver, the Riccati solution, and every disturbance."""

import math

import numpy as np
import pytest
from scipy import integrate, optimize

from meanflock.studies.paper import optimum
from meanflock.swarm.scenario import Scenario
from tests.studies.plain import moved, scenario

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
