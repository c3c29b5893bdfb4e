"""Numbers drawn ahead are those that would have been drawn one after the other, and can be left and taken up again."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.normals import _BLOCK, Normals
from swarm.seeds import random_state

COUNTS = st.lists(st.sampled_from([0, 1, 25, _BLOCK - 1, _BLOCK, _BLOCK + 1, 3 * _BLOCK]), max_size=8)


@settings(deadline=None)
@given(COUNTS, COUNTS)
def test_however_they_are_taken_they_are_the_same_and_go_on_anywhere(first: list[int], then: list[int]) -> None:
    draw, normals = np.random.default_rng(7), Normals(np.random.default_rng(7))
    for count in first:
        np.testing.assert_array_equal(normals.take(count), draw.standard_normal((count, 2)))
    kept = normals.snapshot()
    assert kept == random_state(draw)
    other = Normals(np.random.default_rng(8))
    other.take(5)
    other.restore(kept)
    for count in then:
        expected = draw.standard_normal((count, 2))
        np.testing.assert_array_equal(normals.take(count), expected)
        np.testing.assert_array_equal(other.take(count), expected)
    assert normals.snapshot() == other.snapshot() == random_state(draw)


def test_what_is_not_used_is_seen_again() -> None:
    normals, draw = Normals(np.random.default_rng(1)), np.random.default_rng(1)
    seen = normals.ahead(10)[:10].copy()
    normals.use(4)
    np.testing.assert_array_equal(normals.take(6), seen[4:])
    np.testing.assert_array_equal(seen, draw.standard_normal((10, 2)))
    assert normals.snapshot() == random_state(draw)
