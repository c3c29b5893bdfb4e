"""The pairs of UAVs that are close to each other in a tick."""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import state
from meanflock.kernels.state import Floats

FEW = 100  # UAVs up to which all pairs are compared at once
MANY = 4096  # UAVs above which the sweep goes by strips
LEVELS, LONGER = 8, 8.0  # levels of the extents of segments; each has extents so many times as long
_MARGIN = 1.0 + 1e-6  # more than rounding errors, by which no pair may be missed


def pairs(
    before: Floats, after: Floats, hazard_m: float, collision_m: float, nearest_m: float, found: NDArray[np.intp]
) -> tuple[int, int, float]:
    """Pairs of N UAVs that are close to each other in a tick, in which all UAVs move straight; exactly.

    Distances are those of the closest approach within the tick, and no less than those of the boxes around both
    segments. So a sweep along x that leaves out distant boxes finds what a comparison of all pairs would. Of more than
    `MANY` UAVs it goes by strips along x, so wide that near UAVs are in the same or in the next strip. UAVs with long
    segments have strips of their own. So time grows with N and with the pairs whose boxes are near each other.

    Args:
        before: (N, 4), states at the beginning of the tick; NaN: the UAV has no segment, so it approaches no other.
        after: (N, 4), states at its end; NaN: the UAV is left out.
        hazard_m: distance for the number of near pairs. collision_m: distance for pairs that touch.
        nearest_m: a bound: pairs farther apart than this need not be found for the least distance.
        found: (R, 2), written: the pairs i < j that touch, ascending; if they are more than R, any R of them.

    Returns:
        The number of pairs at most `hazard_m` apart at the end; the number of pairs whose closest approach is less than
        `collision_m`, which may be more than R; the least closest approach of all, m, or `nearest_m` if that is less.
    """
    hazard = hazard_m * hazard_m
    collision = collision_m * collision_m
    nearest = nearest_m * nearest_m
    first, last = state.position(before), state.position(after)
    low, high = np.fmin(first, last), np.fmax(first, last)
    present = np.flatnonzero(~np.isnan(last).any(axis=-1))
    order = present[np.argsort(low[present, 0], kind="stable")]
    few = len(order) <= FEW
    if len(order) > MANY:
        i, j = order[:-1], order[1:]  # some distances: strips are as wide as the least of them
        some = np.maximum(state.approach(first[j] - first[i], last[j] - last[i]), _boxes_apart(low, high, i, j))
        nearest = float(np.fmin.reduce(some, initial=nearest))
        within = math.sqrt(max(hazard, collision, nearest))
        order, left, right, ends = _by_strips(order, low, high, within)
    else:
        left, right = np.triu_indices(len(order), 1) if few else (np.arange(len(order) - 1), np.arange(1, len(order)))
        ends = np.full(len(left), len(order))
    near, touching = 0, [np.zeros((0, 2), dtype=np.intp)]
    while len(left):  # places in the order; next, each left one with the one after its right one
        i, j = order[left], order[right]
        box, reach = _boxes_apart(low, high, i, j), max(hazard, collision, nearest)
        along = np.maximum(low[j, 0] - high[i, 0], 0.0)
        close = ~(box > reach)
        ahead = ~(along * along > reach) & (right + 1 < ends)
        i, j = i[close], j[close]
        apart = last[j] - last[i]
        squared = np.maximum(state.approach(first[j] - first[i], apart), box[close])
        near += int(np.count_nonzero(state.dot(apart, apart) <= hazard))
        nearest = float(np.fmin.reduce(squared, initial=nearest))  # ignores NaN
        touch = squared < collision
        touching.append(np.sort(np.stack([i[touch], j[touch]], axis=-1)))
        left, right, ends = (left[:0],) * 3 if few else (left[ahead], right[ahead] + 1, ends[ahead])
    all_touching = np.concatenate(touching)
    all_touching = all_touching[np.lexsort(all_touching.T[::-1])]
    found[: len(all_touching)] = all_touching[: len(found)]
    return near, len(all_touching), math.sqrt(nearest)


def _boxes_apart(low: Floats, high: Floats, i: NDArray[np.intp], j: NDArray[np.intp]) -> Floats:
    """Squared distances of the boxes from `low` to `high`, (N, d), of pairs of UAVs."""
    gap = np.maximum(np.maximum(low[j] - high[i], low[i] - high[j]), 0.0)
    return state.squared(state.parts(gap))


class _Level:
    """UAVs whose segments have a like extent, in strips along x that are as wide as a box and the distance up to which
    pairs are looked for, or wider.

    order: by strips, in each by x. strip: that of each. begin: place of the first UAV in the order of all levels.
    """

    def __init__(self, order: NDArray[np.intp], low: Floats, high: Floats, within: float, begin: int) -> None:
        """`order`: the UAVs in the order of x."""
        self.along, self.across = np.max((high - low)[order, :2], axis=0)
        self._low = low[order, 1].min()
        beyond = low[order, 1] - self._low
        self._width = max((within + self.across) * _MARGIN, float(beyond.max()) / len(order))
        strip = (beyond / self._width).astype(np.intp)
        by_strip = np.argsort(strip, kind="stable")
        self.order, self.strip, self.begin = order[by_strip], strip[by_strip], begin
        self.places = begin + np.arange(len(order))
        self._keys = self.strip + 1j * low[self.order, 0]  # complex numbers are sorted by their real parts first

    def strip_of(self, y: Floats) -> NDArray[np.intp]:
        """The strips in which numbers (K,) along y lie, or the nearest ones."""
        return np.clip((y - self._low) / self._width, 0, self.strip[-1]).astype(np.intp)

    def window(self, strip: NDArray[np.intp], least: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """First and end of the places (K,) that have a strip and at least some x."""
        first = np.searchsorted(self._keys, strip + 1j * least)
        return self.begin + first, self.begin + np.searchsorted(self.strip, strip + 1)


def _by_strips(
    order: NDArray[np.intp], low: Floats, high: Floats, within: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The UAVs of `order`, which is that of x, by levels of the extents of their segments; and what the sweep compares.

    Args:
        low, high: (N, d), the boxes. within: distance up to which pairs are looked for, m.

    Returns:
        The order; places of it, each with the first and the end of the places that it is compared with. Of its own
        level these are those behind it in its strip and in the next one, of each level of longer segments those of
        all strips within reach.
    """
    extent = (high - low)[order, :2].max(axis=1)
    number = (extent[:, None] > within * LONGER ** np.arange(1.0, LEVELS)).sum(axis=1)
    levels: list[_Level] = []
    for one in np.unique(number):
        levels.append(_Level(order[number == one], low, high, within, sum(len(level.order) for level in levels)))
    windows = []
    for n, level in enumerate(levels):
        x, bottom, top = low[level.order, 0], low[level.order, 1], high[level.order, 1]
        _, end = level.window(level.strip, x)
        windows.append((level.places, level.places + 1, end))
        windows.append((level.places, *level.window(level.strip + 1, x - (within + level.along) * _MARGIN)))
        for longer in levels[n + 1 :]:
            least = x - (within + longer.along) * _MARGIN
            strip = longer.strip_of(bottom - (within + longer.across) * _MARGIN)
            last = longer.strip_of(top + within * _MARGIN)
            for ahead in range(int((last - strip).max()) + 1):
                some = strip + ahead <= last
                windows.append((level.places[some], *longer.window((strip + ahead)[some], least[some])))
    left, right, ends = (np.concatenate(parts) for parts in zip(*windows, strict=True))
    some = right < ends
    return np.concatenate([level.order for level in levels]), left[some], right[some], ends[some]
