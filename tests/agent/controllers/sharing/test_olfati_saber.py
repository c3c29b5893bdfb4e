"""The lattice: forces are gradients, vanish at its distance and add up to nothing."""

import numpy as np
import pytest

from meanflock.swarm.errors import BadInput
from tests.agent.controllers.by_hand import DISCS, accelerations, made

UNLIMITED = "controller.acceleration_max_m_s2=1e9"
ALONE = (UNLIMITED, "controller.pull_m_s2=1e-12", "controller.damping_1_s=1e-12")


def pair(distance: float, *settings: str) -> np.ndarray:
    states = np.array([[0.0, 0, 0, 0], [distance, 0, 0, 0]])
    return accelerations("olfati-saber", states, *ALONE, *settings)


def test_a_pair_is_repelled_within_the_distance_attracted_beyond_and_at_rest_at_it() -> None:
    with pytest.raises(BadInput, match=r"`a` 9\.0 is greater than `b` 8\.0"):
        made("olfati-saber", "controller.a=9.0")
    np.testing.assert_allclose(pair(1.3), 0.0, atol=1e-10)
    assert pair(0.9)[0, 0] < -0.1
    assert pair(1.42)[0, 0] > 1e-3
    np.testing.assert_allclose(pair(1.57), 0.0, atol=1e-10)
    np.testing.assert_allclose(pair(0.0), 0.0, atol=1e-10)


def test_the_force_of_a_pair_is_that_of_the_source() -> None:
    """At 0.9 m, worked by hand: ‖z‖σ = (√(1+.1·.81) − 1)/.1 and so on."""
    sigma, lattice, reach = ((np.sqrt(1 + 0.1 * d * d) - 1) / 0.1 for d in (0.9, 1.3, 1.56))
    weight = 0.5 * (1 + np.cos(np.pi * (sigma / reach - 0.2) / 0.8))
    z = sigma - lattice
    force = weight * 8.0 * z / np.sqrt(1 + z * z) * 0.9 / np.sqrt(1 + 0.1 * 0.81)
    np.testing.assert_allclose(pair(0.9), [[force, 0.0], [-force, 0.0]], rtol=1e-9, atol=1e-10)


def test_an_obstacle_repels_and_slows_a_uav_that_comes_near() -> None:
    far, near = np.array([[20.0, 0.0, -2.0, 0.0]]), np.array([[12.5, 0.0, -2.0, 1.0]])
    np.testing.assert_array_equal(accelerations("olfati-saber", far, DISCS), accelerations("olfati-saber", far))
    push = accelerations("olfati-saber", near, DISCS, UNLIMITED) - accelerations("olfati-saber", near)
    assert push[0, 0] > 1.0
    np.testing.assert_allclose(push[0, 1], -0.5 * 0.2, rtol=1e-9)  # along the edge the agent is a fifth slower
