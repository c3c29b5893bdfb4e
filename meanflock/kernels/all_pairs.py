"""The pairs of UAVs that are close to each other in a tick."""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import state
from meanflock.kernels.state import Floats

FEW = 100  # UAVs up to which all pairs are compared at once
MANY = 4096  # UAVs above which the sweep goes by strips
_MARGIN = 1.0 + 1e-6  # more than rounding errors, by which no pair may be missed


def pairs(
    before: Floats, after: Floats, hazard_m: float, collision_m: float, nearest_m: float, found: NDArray[np.intp]
) -> tuple[int, int, float]:
    """Pairs of N UAVs that are close to each other in a tick, in which all UAVs move straight; exactly.

    Distances are those of the closest approach within the tick, and no less than those of the boxes around both
    segments. So a sweep along x that leaves out distant boxes finds what a comparison of all pairs would. Of more than
    `MANY` UAVs it goes by strips along x, so wide that near UAVs are in the same or in the next strip: time grows with
    N as long as the flock does not get denser.

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


def _by_strips(
    order: NDArray[np.intp], low: Floats, high: Floats, within: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The UAVs of `order`, which is that of x, strip by strip; and what the sweep compares.

    Args:
        low, high: (N, d), the boxes. within: distance up to which pairs are looked for, m.

    Returns:
        The order; places of it, each with the first and the end of the places that it is compared with: those behind it
        in its own strip, and those of the next strip that are not too far behind along x.
    """
    extent = np.max(high[order] - low[order], axis=0)
    across = low[order, 1] - low[order, 1].min()
    width = max((within + extent[1]) * _MARGIN, float(across.max()) / len(order))
    strip = (across / width).astype(np.intp)
    by_strip = np.argsort(strip, kind="stable")
    order, strip = order[by_strip], strip[by_strip]
    begin = np.searchsorted(strip, np.arange(strip[-1] + 3))  # of each strip, and of two empty ones behind the last
    along, places = low[order, 0], np.arange(len(order))
    behind = np.empty_like(places)
    for one in range(strip[-1] + 1):
        own, beside = places[begin[one] : begin[one + 1]], along[begin[one + 1] : begin[one + 2]]
        behind[own] = begin[one + 1] + np.searchsorted(beside, along[own] - (within + extent[0]) * _MARGIN)
    left = np.concatenate([places, places])
    right, ends = np.concatenate([places + 1, behind]), np.concatenate([begin[strip + 1], begin[strip + 2]])
    some = right < ends
    return order, left[some], right[some], ends[some]
