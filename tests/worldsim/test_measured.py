"""What the kernel measures of all pairs and of all models is what NumPy and a tree say."""

from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from swarm import model
from swarm.scenario import Metrics
from tests.worldsim.test_kernel import needs_kernel
from worldsim import kernel, metrics
from worldsim.summary import weight_spread


@needs_kernel
@given(st.integers(0, 300), st.integers(0, 2**32), st.sampled_from([0.0, 1e-300, 1e160, 12.5]))
def test_distances_add_up_to_what_they_do_without_the_kernel(count: int, seed: int, far: float) -> None:
    columns = np.random.default_rng(seed).normal(size=(2, count))
    columns[:, count // 2 :] += far
    with np.errstate(over="ignore"):
        assert kernel.distances(columns) == metrics.distances(columns)


@needs_kernel
@given(
    arrays(np.float64, st.tuples(st.integers(0, 60), st.just(2)), elements=st.sampled_from([0.0, 0.3, -0.4, 0.5, 9.0])),
    st.sampled_from([0.1, 0.5, 0.6, 20.0]),
    st.sampled_from([0.1, 0.5, 1.0]),
)
def test_who_is_near_is_who_a_tree_finds(points: np.ndarray, hazard: float, collision: float) -> None:
    radii = Metrics(hazard_radius=hazard, collision_radius=collision)
    with_kernel = metrics._near(radii, points)
    with patch.object(kernel, "_kernel", None):
        without = metrics._near(radii, points)
    assert with_kernel[0] == without[0]
    assert sorted(with_kernel[1].tolist()) == sorted(without[1].tolist())


@needs_kernel
@pytest.mark.parametrize("given", [np.zeros(3), np.zeros((2, 4), np.float32), np.zeros((4, 2)).T, [0.0]])
def test_points_that_are_no_columns_are_refused(given: Any) -> None:
    with pytest.raises((TypeError, ValueError, BufferError)):
        kernel._kernel.distances(given)
    with pytest.raises((TypeError, ValueError, BufferError)):
        kernel._kernel.near(given, 1.0, 1.0, 1.0)


@needs_kernel
@given(st.integers(1, 300), st.integers(0, 2**32), st.sampled_from([0.0, 1e-200, 1e150, np.nan, np.inf, 1e9]))
def test_how_far_models_are_apart_is_what_it_is_without_the_kernel(uavs: int, seed: int, wild: float) -> None:
    models = np.random.default_rng(seed).normal(0, 3, (uavs, 246))
    models[seed % uavs, seed % 246] = wild
    apart = kernel.spread(models)
    if (np.abs(models) < model.BEYOND_SENSE).all():
        assert apart == weight_spread(models)
    else:
        assert apart is None
    assert kernel.spread(models[:0]) is None


@needs_kernel
@pytest.mark.parametrize(
    "given",
    [
        (np.zeros((2, 3)), 2, 4, 1.0),
        (np.zeros((2, 3)), -1, 3, 1.0),
        (np.zeros((2, 3)), 2**62, 2**62, 1.0),
        (np.zeros((2, 0)), 2, 0, 1.0),
        (np.zeros((2, 3), np.float32), 2, 3, 1.0),
        (np.zeros((2, 6))[:, ::2], 2, 3, 1.0),
        ([0.0], 1, 1, 1.0),
    ],
)
def test_models_that_are_no_such_table_are_refused(given: tuple[Any, ...]) -> None:
    with pytest.raises((TypeError, ValueError, BufferError)):
        kernel._kernel.spread(*given)
