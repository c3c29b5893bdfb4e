"""The terms of the flocking model, worked by hand."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from meanflock.agent.controllers.sharing.vasarhelyi import Vasarhelyi, braking
from tests.agent.controllers.by_hand import DISCS, accelerations, made, stepped

TAU = 0.4


@given(slope=st.floats(0.1, 10.0), most=st.floats(0.1, 10.0), distance=st.floats(0.0, 50.0))
def test_from_the_allowed_speed_a_uav_stops_within_the_distance(slope: float, most: float, distance: float) -> None:
    """Braking along D takes at most `most` m/s², and it never turns round."""
    ways = np.linspace(0.0, distance, 2000)
    speed = braking(ways, slope, most)
    assert speed[0] == 0.0
    assert (np.diff(speed) >= 0.0).all()
    deceleration = 0.5 * np.diff(speed**2) / np.maximum(np.diff(ways), 1e-12)  # v dv/dr
    assert deceleration.max() <= most * (1 + 1e-6)
    assert not braking(-ways, slope, most).any()


def test_a_uav_that_closes_in_too_fast_is_slowed() -> None:
    """At 2.5 m the brake allows √(2·0.5·2 − 1/9) = 1.374 m/s; half of the rest is taken off."""
    states = np.array([[70.0, 0.0, 1.0, 0.0], [72.5, 0.0, -1.0, 0.0]])
    push = accelerations("vasarhelyi", states) * TAU - accelerations("cruise", states)
    rest = 0.5 * (2.0 - np.sqrt(2.0 - 1.0 / 9.0))
    np.testing.assert_allclose(push, [[-rest, 0.0], [rest, 0.0]], rtol=1e-9)


def test_an_obstacle_repels_by_agents_that_move_away_from_its_edge() -> None:
    far, near = np.array([[60.0, 0.0, -2.0, 0.0]]), np.array([[12.4, 0.0, -2.0, 0.0]])
    free, met = (accelerations("vasarhelyi", states, DISCS) for states in (far, near))
    np.testing.assert_allclose(free, accelerations("vasarhelyi", far), atol=1e-12)
    np.testing.assert_allclose((met - accelerations("vasarhelyi", near)) * TAU, [[2.0 + 4.0, 0.0]], rtol=1e-9)


def test_pairs_left_out_early_could_not_have_pushed() -> None:
    controller: Vasarhelyi = made("vasarhelyi", uavs=30)  # type: ignore[assignment]
    every = made("vasarhelyi", uavs=30)
    every._matters = lambda squared, difference: np.isfinite(squared)  # type: ignore[attr-defined]
    pushed = 0
    for seed in range(20):
        draw = np.random.default_rng(seed)
        states = np.concatenate([draw.uniform(-8, 8, (30, 2)), draw.normal(0, 1.5, (30, 2))], axis=1)
        one, other = (stepped(made_, states).acceleration for made_ in (controller, every))
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
        pushed += (np.abs(one - accelerations("cruise", states) / TAU) > 1e-6).any(axis=1).sum()
    assert pushed > 300
