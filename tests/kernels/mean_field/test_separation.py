"""The repulsion from near UAVs: its closed form, and the same bits in both forms."""

import math
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meanflock.kernels import reference
from meanflock.kernels.mean_field.separation import FARTHEST, decay

any_number = st.floats(allow_nan=True, allow_infinity=True, width=64)


def pushed(backend: ModuleType, states: np.ndarray, known: np.ndarray, weight: float, range_m: float) -> np.ndarray:
    result = np.full((len(states), 2), 7.0)
    backend.repel(states, known, weight, range_m, result)
    return result


def test_the_decay_is_an_exponential() -> None:
    u = np.concatenate([np.linspace(0.0, FARTHEST, 20_001), [1e-300, math.log(2) / 2]])
    np.testing.assert_allclose(decay(u), np.exp(-u), rtol=4e-16, atol=0)
    assert (decay(np.array([FARTHEST + 1e-9, 1e300, np.inf, np.nan])) == 0.0).all()
    assert decay(np.zeros(1)) == 1.0


def test_two_uavs_that_meet_are_pushed_apart_alike(backend: ModuleType) -> None:
    """By w d exp(−d²/2ℓ²) each, along the line between them, whatever their velocities; nobody pushes itself."""
    states = np.array([[0.0, 0.0, 3.0, 1.0], [0.3, 0.4, -2.0, 0.0]])
    both = pushed(backend, states, np.repeat(states[None], 2, axis=0), 5.0, 0.5)
    np.testing.assert_allclose(both[1], 5.0 * np.array([0.3, 0.4]) * math.exp(-0.5), rtol=1e-15)
    np.testing.assert_array_equal(both[0], -both[1])
    alone = pushed(backend, states, states[:, None], 5.0, 0.5)
    np.testing.assert_array_equal(alone, 0.0)


@settings(max_examples=100, deadline=None)
@given(
    arrays(np.float64, (2, 4), elements=any_number),
    arrays(np.float64, (2, 9, 4), elements=any_number),
    st.sampled_from([0, 1, 7, 129, 300]),
    st.sampled_from([0.05, 0.5, 40.0]),
)
def test_both_forms_give_the_same_finite_bits_for_any_numbers(
    states: np.ndarray, known: np.ndarray, others: int, range_m: float
) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    near = np.random.default_rng(others).normal(0, 1.0, (9, 4 * others + 4))
    for given_ in ((states, known), (near[:, :4].copy(), near[:, 4:].reshape(9, others, 4).copy())):
        first, second = (pushed(backend, *given_, 5.0, range_m) for backend in (compiled, reference))
        assert first.tobytes() == second.tobytes()
        assert np.isfinite(first).all()
