"""Who is among whom: what NumPy's `isin` says."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from meanflock.swarm.ascending import contains

NUMBERS = st.lists(st.integers(-50, 50), max_size=30)


@given(NUMBERS, NUMBERS)
def test_it_is_what_numpy_finds(known: list[int], asked: list[int]) -> None:
    ascending, numbers = np.unique(np.array(known, dtype=np.intp)), np.array(asked, dtype=np.int32)
    np.testing.assert_array_equal(contains(ascending, numbers), np.isin(numbers, ascending))
