"""Columns of two tables side by side: both forms against NumPy, for tables of any strides."""

from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@both_forms
@given(st.integers(0, 5), st.integers(0, 4), st.integers(0, 4), st.booleans(), st.integers(0, 2**32 - 1))
def test_columns_of_any_strides_are_side_by_side(
    backend: ModuleType, rows: int, first: int, second: int, turned: bool, seed: int
) -> None:
    whole = np.random.default_rng(seed).normal(0, 1e3, (2 * rows, first + second))[::2]
    whole = np.asfortranarray(whole) if turned else whole
    out = np.full(whole.shape, 7.0)
    right = whole[:, first:] if second or turned else None
    assert backend.columns(whole[:, :first], right, out, first) == np.abs(whole).max(initial=0.0)
    np.testing.assert_array_equal(out, whole)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [(0, 0), (1, 3), (2, 4)])
def test_the_largest_tells_whether_a_number_is_not_finite(
    backend: ModuleType, bad: float, where: tuple[int, int]
) -> None:
    whole = np.ones((3, 5))
    whole[where] = bad
    whole[2, 2] = 1e300
    largest = backend.columns(whole[:, :2], whole[:, 2:], np.empty((3, 5)), 2)
    assert np.isnan(largest) if np.isnan(bad) else largest == np.inf


@pytest.mark.parametrize(
    ("left", "right", "out"),
    [
        (np.zeros((3, 2)), np.zeros((3, 2)), (3, 5)),
        (np.zeros((2, 2)), np.zeros((2, 3)), (3, 5)),
        (np.zeros((3, 3)), np.zeros((3, 2)), (3, 5)),
        (np.zeros((3, 2)), None, (3, 5)),
        (np.zeros((3, 2, 1)), np.zeros((3, 3)), (3, 5)),
        (np.zeros((3, 2)), np.zeros((3, 3), np.float32), (3, 5)),
        (np.zeros((3, 2), np.int64), np.zeros((3, 3)), (3, 5)),
    ],
)
def test_tables_that_do_not_fit_are_refused_and_nothing_is_written(
    backend: ModuleType, left: np.ndarray, right: np.ndarray | None, out: tuple[int, int]
) -> None:
    room = np.full(out, 7.0)
    with pytest.raises(ValueError, match="columns"):
        backend.columns(left, right, room, 2)
    assert (room == 7.0).all()
