"""Inner products of states are sums of NumPy to the last bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meanflock.swarm import state

COMPONENTS = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1e-320, 1e300]), st.floats(allow_nan=False, width=64))


@given(st.data(), st.sampled_from([1, 2, 4, 27]), st.sampled_from([(), (1,), (5,), (3, 2)]))
def test_a_dot_product_is_the_sum_of_the_products_to_the_last_bit(
    data: st.DataObject, size: int, shape: tuple[int, ...]
) -> None:
    first, second = (data.draw(arrays(np.float64, (*shape, size), elements=COMPONENTS)) for _ in range(2))
    with np.errstate(all="ignore"):
        found, expected = state.dot(first, second), (first * second).sum(axis=-1)
    assert np.shape(found) == shape
    one, other = (np.where(np.isnan(numbers), np.nan, numbers) for numbers in (found, expected))
    assert one.tobytes() == other.tobytes()
