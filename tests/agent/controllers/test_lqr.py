"""The gains of the regulator are those of the Riccati equation, solved otherwise."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

from meanflock.agent.controllers.lqr import gains


@given(position=st.floats(1e-6, 1e3), velocity=st.floats(0.0, 1e3))
def test_the_closed_form_solves_the_riccati_equation(position: float, velocity: float) -> None:
    push = np.array([[0.0], [1.0]])
    p = solve_continuous_are(np.array([[0.0, 1.0], [0.0, 0.0]]), push, np.diag([position, velocity]), np.eye(1))
    np.testing.assert_allclose(gains(position, velocity), (push.T @ p)[0], rtol=1e-5)
