"""Closest approaches of each UAV, against all pairs one by one."""

import math

import numpy as np
import pytest

from meanflock.worldsim import group_measures
from meanflock.worldsim.group_measures import closest_of_each


def one_by_one(before: np.ndarray, after: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """The least distance at any of many instants of the tick."""
    axes = before.shape[1] // 2
    share = np.linspace(0.0, 1.0, 2001)[:, None, None]
    places = before[:, :axes] + share * (after - before)[:, :axes]
    apart = np.sqrt(((places[:, :, None] - places[:, None]) ** 2).sum(axis=-1)).min(axis=0)
    apart[np.diag_indices(len(apart))] = math.inf
    return np.fmin(bound, np.fmin.reduce(apart, axis=1, initial=math.inf))


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("at_once", [1, 100, 10**6])
def test_the_closest_approach_of_each_uav_is_that_of_all_its_pairs(
    axes: int, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(group_measures, "_PAIRS", at_once)
    draw = np.random.default_rng(axes)
    for bound in (math.inf, 1.5, 0.01):
        before = draw.normal(size=(20, 2 * axes)) * 5.0
        after = before + draw.normal(size=before.shape) * 3.0
        before[3], after[5], after[6] = np.nan, np.nan, np.nan  # no segment; on the ground
        bounds = np.full(20, bound)
        found = closest_of_each(before, after, bounds)
        assert found == pytest.approx(one_by_one(before, after, bounds), abs=5e-3)
        assert (found[[3, 5, 6]] == bound).all()
