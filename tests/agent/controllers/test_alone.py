"""Controllers without neighbours: `cruise` and `lqr`, and all that fly to goals of their own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

import meanflock as mf
from meanflock.agent.controllers.lqr import gains
from tests.agent.controllers.by_hand import accelerations

CALM = {"wind.sigma": 0.0}


def test_far_off_it_flies_at_cruise_speed_and_near_the_goal_slower() -> None:
    states = np.array([[300.0, 400.0, 0, 0], [0.0, -5.5, 0, 0], [6.0, 0.0, 1.0, 2.0], [0, 0, 0, 0]])
    wanted = np.array([[-0.6 * 2.25, -0.8 * 2.25], [0.0, 2.25], [-2.25 - 1.0, -2.0], [0.0, 0.0]])
    np.testing.assert_allclose(accelerations("cruise", states), wanted, rtol=1e-12)
    slow = accelerations("cruise", states[1:2], "controller.slowing_1_s=0.1", "controller.velocity_gain_1_s=3")
    np.testing.assert_allclose(slow, [[0.0, 3 * 0.55]], rtol=1e-12)


def test_it_stays_where_it_arrives() -> None:
    run = mf.fly("paper", method="cruise", uavs=1, duration=120, stop="duration", **CALM)
    arrived = np.flatnonzero(np.sqrt((run.states[:, 0] ** 2).sum(axis=-1)) <= 5.0)[0]
    end = run.states[-1, 0, :2]
    assert np.hypot(*(end - run.states[arrived, 0, :2])) < 1.0
    assert np.hypot(*end) > 2.0
    assert np.hypot(*run.states[-1, 0, 2:]) < 1e-3
    assert run.summary["payload_bits"]["total"] == 4 * 32  # the mission plan, before take-off


@pytest.mark.parametrize("method", ["cruise", "lqr", "plan", "vasarhelyi", "olfati-saber", "potential-field"])
def test_each_comes_to_a_goal_of_its_own(method: str) -> None:
    goals = [[40.0, -10.0], [0.0, 30.0], [-20.0, 5.0]]
    way = {"start.positions": [[60.0, 0.0], [30.0, 60.0], [20.0, -30.0]], "destination.positions": goals}
    run = mf.fly("paper", method=method, uavs=3, **way)
    assert run.summary["arrived"] == 3
    assert (np.hypot(*(run.states[-1, :, :2] - goals).T) < 5.0).all()


@given(position=st.floats(1e-6, 1e3), velocity=st.floats(0.0, 1e3))
def test_the_closed_form_solves_the_riccati_equation(position: float, velocity: float) -> None:
    push = np.array([[0.0], [1.0]])
    p = solve_continuous_are(np.array([[0.0, 1.0], [0.0, 0.0]]), push, np.diag([position, velocity]), np.eye(1))
    np.testing.assert_allclose(gains(position, velocity), (push.T @ p)[0], rtol=1e-5)
