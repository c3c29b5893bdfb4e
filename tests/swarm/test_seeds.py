"""Generators of random numbers by name."""

import itertools

import pytest

from meanflock.swarm.seeds import STREAMS, generator


def test_a_seed_a_stream_and_an_index_give_numbers_of_their_own() -> None:
    keys = list(itertools.product((0, 1, 2**62), STREAMS, (0, 1, 2)))
    first, again = ([tuple(generator(*key).integers(2**63, size=2)) for key in keys] for _ in range(2))
    assert first == again
    assert len(set(first)) == len(keys)


def test_an_unknown_stream_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no stream 'weather'; there are .*controller"):
        generator(1, "weather")
