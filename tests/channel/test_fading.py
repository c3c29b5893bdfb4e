"""Fading drawn ahead is the fading that would have been drawn slot by slot, and can be left and taken up again."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from channel.fading import Fading
from channel.rician import squared_amplitude
from swarm import normals
from swarm.scenario import load
from swarm.seeds import random_state

RADIO = load(None).radio
COUNTS = st.lists(st.integers(0, 3 * normals._BLOCK // 2), max_size=8)


def slot_by_slot(draw: np.random.Generator, counts: list[int]) -> list[np.ndarray]:
    return [squared_amplitude(draw.standard_normal((count, 2)), RADIO.rice_xi, RADIO.rice_chi) for count in counts]


@settings(deadline=None)
@given(COUNTS, COUNTS)
def test_however_it_is_asked_for_it_is_the_same_and_so_is_what_is_kept_of_it(first: list[int], then: list[int]) -> None:
    draw, ahead = np.random.default_rng(7), Fading(np.random.default_rng(7), RADIO)
    for expected, count in zip(slot_by_slot(draw, first), first, strict=True):
        np.testing.assert_array_equal(ahead.squared(count), expected)
    kept = ahead.snapshot()
    assert kept == random_state(draw)

    other = Fading(np.random.default_rng(8), RADIO)
    other.squared(5)
    other.restore(kept)
    assert other.snapshot() == kept
    for expected, count in zip(slot_by_slot(draw, then), then, strict=True):
        np.testing.assert_array_equal(ahead.squared(count), expected)
        np.testing.assert_array_equal(other.squared(count), expected)
    assert ahead.snapshot() == other.snapshot() == random_state(draw)
