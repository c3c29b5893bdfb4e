"""Who is among whom, and who there is: what NumPy's `isin` and `unique` say."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from meanflock.swarm.ascending import contains, distinct

NUMBERS = st.lists(st.integers(-50, 50), max_size=30)


@given(NUMBERS, NUMBERS)
def test_it_is_what_numpy_finds(known: list[int], asked: list[int]) -> None:
    ascending, numbers = np.unique(np.array(known, dtype=np.intp)), np.array(asked, dtype=np.int32)
    np.testing.assert_array_equal(contains(ascending, numbers), np.isin(numbers, ascending))


@given(NUMBERS)
def test_each_is_there_once(asked: list[int]) -> None:
    numbers = np.array(asked, dtype=np.int32)
    found = distinct(numbers)
    np.testing.assert_array_equal(found, np.unique(numbers))
    assert found.dtype == numbers.dtype
