"""Generators of random numbers by name."""

import itertools

import numpy as np
import pytest

from meanflock.swarm.seeds import STREAMS, generator


def test_the_same_name_always_gives_the_same_numbers() -> None:
    for stream in STREAMS:
        one, other = generator(7, stream, 3), generator(7, stream, 3)
        np.testing.assert_array_equal(one.standard_normal(100), other.standard_normal(100))


def test_another_seed_stream_or_index_gives_other_numbers() -> None:
    keys = list(itertools.product((0, 1, 2**62), STREAMS, (0, 1, 2)))
    drawn = {tuple(generator(*key).integers(2**63, size=2)) for key in keys}
    assert len(drawn) == len(keys)


def test_an_unknown_stream_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no stream 'weather'; there are .*controller"):
        generator(1, "weather")
