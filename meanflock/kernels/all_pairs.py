"""The pairs of UAVs that are close to each other in a tick."""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import state
from meanflock.kernels.state import Floats

FEW = 100  # UAVs up to which all pairs are compared at once


def pairs(
    before: Floats, after: Floats, hazard_m: float, collision_m: float, nearest_m: float, found: NDArray[np.intp]
) -> tuple[int, int, float]:
    """Pairs of N UAVs that are close to each other in a tick, in which all UAVs move straight; exactly.

    Distances are those of the closest approach within the tick, and no less than those of the boxes around both
    segments. So a sweep along x that leaves out distant boxes finds what a comparison of all pairs would.

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
    left, right = np.triu_indices(len(order), 1) if few else (np.arange(len(order) - 1), np.arange(1, len(order)))
    near, touching = 0, [np.zeros((0, 2), dtype=np.intp)]
    while len(left):  # places in the order; next, each left one with the one after its right one
        i, j = order[left], order[right]
        gap = np.maximum(np.maximum(low[j] - high[i], low[i] - high[j]), 0.0)
        along, box, reach = gap[:, 0], state.squared(state.parts(gap)), max(hazard, collision, nearest)
        close = ~(box > reach)
        i, j = i[close], j[close]
        apart = last[j] - last[i]
        squared = np.maximum(state.approach(first[j] - first[i], apart), box[close])
        near += int(np.count_nonzero(state.dot(apart, apart) <= hazard))
        nearest = float(np.fmin.reduce(squared, initial=nearest))  # ignores NaN
        touch = squared < collision
        touching.append(np.sort(np.stack([i[touch], j[touch]], axis=-1)))
        ahead = ~(along * along > reach) & (right < len(order) - 1)
        left, right = (left[:0], right[:0]) if few else (left[ahead], right[ahead] + 1)
    all_touching = np.concatenate(touching)
    all_touching = all_touching[np.lexsort(all_touching.T[::-1])]
    found[: len(all_touching)] = all_touching[: len(found)]
    return near, len(all_touching), math.sqrt(nearest)
