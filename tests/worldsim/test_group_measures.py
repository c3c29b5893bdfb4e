"""Closest approaches of a group, against all its pairs one by one."""

import math

import numpy as np
import pytest

from meanflock.worldsim.group_measures import closest_approach


def one_by_one(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The least distance of each UAV to any other at any of many instants of the tick, (N,)."""
    axes = before.shape[1] // 2
    share = np.linspace(0.0, 1.0, 2001)[:, None, None]
    places = before[:, :axes] + share * (after - before)[:, :axes]
    apart = np.sqrt(((places[:, :, None] - places[:, None]) ** 2).sum(axis=-1)).min(axis=0)
    apart[np.diag_indices(len(apart))] = math.inf
    return np.fmin.reduce(apart, axis=1, initial=math.inf)


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("spread", [0.5, 5.0, 200.0])
def test_the_closest_approach_of_a_group_is_that_of_its_pairs(axes: int, spread: float) -> None:
    """Some UAVs fly no segment, or are on the ground; the group may be far from the others, or among them."""
    draw = np.random.default_rng(axes)
    for away in (0.0, 30.0):
        before = draw.normal(size=(20, 2 * axes)) * spread
        before[4:9, 0] += away
        after = before + draw.normal(size=before.shape) * 3.0
        before[3], after[5], after[6] = np.nan, np.nan, np.nan
        each = one_by_one(before, after)
        for rows in (slice(0, 4), slice(4, 9), slice(9, 20), slice(0, 20)):
            least = each[rows].min()
            for bound in (math.inf, 1.5, 0.01):
                assert closest_approach(before, after, rows, bound) == pytest.approx(min(bound, least), abs=5e-3)
        assert closest_approach(before, after, slice(5, 7), math.inf) == math.inf
