"""Functions of states and vectors."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meanflock.kernels import state


@given(st.integers(1, 9), st.integers(1, 7), st.data())
def test_inner_products_are_added_in_the_order_of_the_axes(rows: int, axes: int, data: st.DataObject) -> None:
    """To the last bit; −0 counts as 0. NumPy adds more than seven products in another order."""
    numbers = arrays(np.float64, (rows, axes), elements=st.floats(-1e100, 1e100))
    first, second = data.draw(numbers), data.draw(numbers)
    total = np.zeros(rows)
    for products in (first * second).T:
        total = total + products
    assert state.dot(first, second).tobytes() == total.tobytes()
    assert state.dot(first[0], second[0]).tobytes() == total[0].tobytes()
