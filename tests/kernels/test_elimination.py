"""Systems of linear equations, products, and the nearest few: both forms against NumPy, and against each other."""

from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from meanflock.kernels import reference

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
seeds = st.integers(0, 2**32 - 1)


@both_forms
@given(st.integers(0, 4), st.integers(1, 9), st.integers(1, 5), seeds)
def test_systems_are_solved_one_by_one(backend: ModuleType, systems: int, size: int, sides: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    matrices, rights = draw.normal(size=(systems, size, size)), draw.normal(size=(systems, size, sides))
    matrices[::2, 0, 0] = 0.0  # the first pivot is another row
    found, defined = np.empty_like(rights), np.empty_like(rights)
    backend.solve(matrices, rights, found)
    reference.solve(matrices, rights, defined)
    np.testing.assert_array_equal(found, defined)
    regular = np.abs(np.linalg.det(matrices)) > 1e-3
    np.testing.assert_allclose(matrices[regular] @ found[regular], rights[regular], atol=1e-6)
    if systems:
        alone = np.empty_like(rights[:1])
        backend.solve(matrices[-1:].copy(), rights[-1:].copy(), alone)
        np.testing.assert_array_equal(alone, found[-1:])


@pytest.mark.parametrize("entry", [0.0, np.nan, np.inf])
def test_a_singular_system_has_no_finite_solution(backend: ModuleType, entry: float) -> None:
    matrices = np.stack([np.eye(3), np.eye(3)])
    matrices[1, 1, 1] = entry
    found = np.empty((2, 3, 1))
    backend.solve(matrices, np.ones((2, 3, 1)), found)
    np.testing.assert_array_equal(found[0], 1.0)
    assert entry == np.inf or not np.isfinite(found[1]).all()


@both_forms
@given(st.sampled_from([(3, 3), (1, 3), (3, 1), (1, 1)]), st.tuples(*[st.integers(1, 7)] * 3), seeds)
def test_products_are_sums_in_the_order_of_their_terms(
    backend: ModuleType, systems: tuple[int, int], sizes: tuple[int, int, int], seed: int
) -> None:
    draw, (n, m, k) = np.random.default_rng(seed), sizes
    left, right = draw.normal(size=(systems[0], n, m)), draw.normal(size=(systems[1], m, k))
    found = np.empty((max(systems), n, k))
    backend.multiply(left, right, found)
    terms = left[:, :, :, None] * right[:, None]
    total = terms[:, :, 0]
    for term in range(1, m):
        total = total + terms[:, :, term]
    np.testing.assert_array_equal(found, total)


@both_forms
@given(st.integers(0, 4), st.integers(0, 12), st.integers(0, 6), seeds)
def test_the_nearest_few_come_first_and_ties_in_their_order(
    backend: ModuleType, rows: int, objects: int, most: int, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    distance = draw.integers(0, 6, size=(rows, objects)).astype(float)
    distance[draw.random(distance.shape) < 0.1] = np.nan
    found = np.full((rows, most), 7, dtype=np.intp)
    largest = backend.closest(distance, 4.0, found)
    for row, numbers in zip(distance, found, strict=True):
        expected = sorted((apart, number) for number, apart in enumerate(row) if apart <= 4.0)[:most]
        assert numbers.tolist() == [number for _, number in expected] + [-1] * (most - len(expected))
    assert largest == (found >= 0).sum(axis=1).max(initial=0)
