"""The repulsion is the slope of Khatib's potential, of UAVs and of discs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from meanflock.agent.controllers.sharing.potential_field import repulsion
from tests.agent.controllers.by_hand import DISCS, accelerations


@given(rho=st.floats(0.05, 4.9), rho0=st.floats(0.2, 5.0), eta=st.floats(0.1, 10.0))
def test_the_force_is_the_slope_of_the_potential(rho: float, rho0: float, eta: float) -> None:
    def potential(at: float) -> float:
        return 0.5 * eta * (1.0 / at - 1.0 / rho0) ** 2 if at < rho0 else 0.0

    step = 1e-5 * rho
    slope = (potential(rho - step) - potential(rho + step)) / (2 * step)
    force = float(repulsion(np.array([rho]), rho0, eta, np.inf)[0])
    assert abs(force - slope) <= 1e-4 * max(abs(slope), eta / rho**2 * 1e-2, eta / rho0**2)


def test_the_force_is_limited_and_points_out_of_a_disc_that_was_entered() -> None:
    forces = repulsion(np.array([-1.0, 0.0, 1e-6, 0.3, 2.0, 9.0]), 2.0, 1.0, 3.0)
    assert forces.tolist() == [3.0, 3.0, 3.0, 3.0, 0.0, 0.0]
    inside = np.array([[11.0, 0.5, 0.0, 0.0]])
    push = accelerations("potential-field", inside, DISCS) - accelerations("potential-field", inside)
    assert push[0, 0] > 2.0
    assert push[0, 1] > 1.0
