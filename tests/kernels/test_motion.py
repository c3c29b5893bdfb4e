"""A tick of motion: both forms against NumPy's operations, one at a time."""

from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@both_forms
@given(st.integers(0, 20), st.booleans(), st.integers(0, 2**32 - 1))
def test_a_point_mass_is_pushed_dragged_and_shaken(backend: ModuleType, uavs: int, alike: bool, seed: int) -> None:
    draw = np.random.default_rng(seed)
    states, push, noise = draw.normal(0, 9, (uavs, 4)), draw.normal(0, 3, (uavs, 2)), draw.normal(size=(uavs, 2))
    wind = draw.normal(0, 2, 2 if alike else (uavs, 2))
    drag, shake, dt = draw.uniform(0, 1, 3)
    moved = np.full((uavs, 4), np.nan)
    backend.move(states, push, noise, wind, drag, shake, dt, moved)
    velocity = (states[:, 2:] + (push - (states[:, 2:] - wind) * drag) * dt) + shake * noise
    np.testing.assert_array_equal(moved[:, 2:], velocity)
    np.testing.assert_array_equal(moved[:, :2], velocity * dt + states[:, :2])


@both_forms
@given(st.integers(0, 30), st.integers(0, 2**32 - 1))
def test_those_within_the_radius_that_were_asked_for_are_counted(backend: ModuleType, uavs: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    states, goals = draw.normal(0, 1, (2, uavs, 4))
    asked = draw.random(uavs) < 0.7
    off = states - goals
    distances = np.sqrt(np.add.reduce(off * off, axis=1))
    radius = float(np.median(distances)) if uavs % 2 else 2.0  # one UAV is exactly there
    within = asked.copy()
    count = backend.reached(states, goals, radius, within)
    np.testing.assert_array_equal(within, asked & (distances <= radius))
    assert count == within.sum()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_uav_that_is_nowhere_has_reached_nothing(backend: ModuleType, bad: float) -> None:
    states, within = np.zeros((2, 4)), np.ones(2, dtype=bool)
    states[1, 3] = bad
    assert backend.reached(states, np.zeros((2, 4)), 1.0, within) == 1
    assert within.tolist() == [True, False]
