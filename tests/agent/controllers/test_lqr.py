"""The gains of the regulator are those of the Riccati equation, solved otherwise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

from meanflock.agent.controllers.lqr import gains
from tests.agent.controllers.by_hand import accelerations


@given(position=st.floats(1e-6, 1e3), velocity=st.floats(0.0, 1e3))
def test_the_closed_form_solves_the_riccati_equation(position: float, velocity: float) -> None:
    push = np.array([[0.0], [1.0]])
    p = solve_continuous_are(np.array([[0.0, 1.0], [0.0, 0.0]]), push, np.diag([position, velocity]), np.eye(1))
    np.testing.assert_allclose(gains(position, velocity), (push.T @ p)[0], rtol=1e-5)


def test_by_default_they_are_one_hundredth_and_three_tenths() -> None:
    assert gains(1e-4, 0.07) == pytest.approx((0.01, 0.3))
    states = np.array([[100.0, -50.0, 1.0, 2.0]])
    np.testing.assert_allclose(accelerations("lqr", states), [[-1.3, -0.1]], rtol=1e-12)
