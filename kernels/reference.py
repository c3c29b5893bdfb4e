"""The kernels in NumPy: what they compute, and how where there is no compiler.

Arrays are C-contiguous float64 unless named otherwise. Rows are independent, to the last bit.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import features, fpk, hjb, interaction, state
from meanflock.kernels.halfplanes import nearest
from meanflock.kernels.separation import repel
from meanflock.kernels.tables import Floats, Tables
from meanflock.kernels.weights import DENSITY, DENSITY_FEATURES, VALUE
from meanflock.kernels.wire import read, write

__all__ = ["BACKEND", "alignment", "columns", "learn", "nearest", "pairs", "prepare", "read", "repel", "write"]

BACKEND = "numpy"
FEW = 100  # UAVs up to which all N² speed differences are one sum, as in pairs.c, and all pairs are compared at once


def prepare(given: Tables) -> Any:
    """The tables as `learn` takes them; whoever calls it keeps them and looks at nothing in them."""
    return given


def learn(
    tables: Tables, states: Floats, weights: Floats, around: Floats | None, weights_out: Floats, numbers: Floats
) -> None:
    """One tick of the mean-field learners of M UAVs: φ_G, the value step, the density step, the action.

    Args:
        states: (M, 4). weights: (M, 246), [ŵ_H0, ŵ_H1, ŵ_F0, ŵ_F1].
        around: None: the density is learned and φ_G is its quadrature. Else the density stays as it is, and φ_G is
            the mean over the states each row knows (M, N, 4), with β = 1, or what is given, (M,).
        weights_out: (M, 246), written; may be `weights`. numbers: (M, 5), written: [a_x, a_y, e_H, e_F, φ_G].
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        powers = features.powers(tables, states)
        if around is not None:
            phi_g = around if around.ndim == 1 else interaction.empirical(states, around, tables.epsilon)
            value = hjb.step(tables, weights[:, VALUE], states, powers, phi_g)
            density, residual = weights[:, DENSITY], np.zeros(len(states))
        else:
            pairs = features.pairs(tables, powers)
            terms = features.terms(tables, pairs)
            density = weights[:, DENSITY]
            phi_g = interaction.quadrature(tables, density[:, :DENSITY_FEATURES], terms)
            value = hjb.step(tables, weights[:, VALUE], states, powers, phi_g)
            drift = hjb.drift(tables, states, value.action)
            density, residual = fpk.step(tables, density, states, pairs, terms[:, 1:], drift, value.curvature)
    weights_out[:, VALUE], weights_out[:, DENSITY] = value.weights, density
    numbers[:, : state.AXES] = value.action
    numbers[:, 2], numbers[:, 3], numbers[:, 4] = value.residual, residual, phi_g


def columns(left: Floats, right: Floats | None, out: Floats, first: int) -> float:
    """Columns of two tables side by side: `left` (M, A) and `right` (M, B), of any strides, into `out` (M, A + B).

    Args:
        right: None where B is 0. first: what A must be.

    Returns:
        The largest of all |numbers|; NaN where one of them is.
    """
    right = out[:, :0] if right is None else right
    for table, width in ((left, first), (right, out.shape[1] - first)):
        if table.shape != (len(out), width) or table.dtype != np.float64:
            raise ValueError("columns: not float64 of as many rows and columns as there is room for")
    out[:, :first], out[:, first:] = left, right
    return float(np.abs(out).max(initial=0.0))


def alignment(states: Floats) -> float:
    """The mean over all N² pairs of UAVs `(N, 4)` of ‖v_j − v_i‖, m/s; 0 of no UAV."""
    n, columns = len(states), np.ascontiguousarray(states[:, state.VELOCITY].T)
    if n <= FEW:
        difference = columns[:, :, None] - columns[:, None, :]
        difference *= difference
        return float(np.add.reduce(np.sqrt(difference[0] + difference[1]).ravel())) / max(1, n * n)
    rows = np.zeros(n - 1)  # Σ_{j > i} ‖v_j − v_i‖ of each i
    for i in range(n - 1):
        difference = columns[:, i + 1 :] - columns[:, i, None]
        difference *= difference
        rows[i] = np.add.reduce(np.sqrt(difference[0] + difference[1]))
    return 2.0 * float(np.add.reduce(rows)) / (float(n) * float(n))


def pairs(
    before: Floats, after: Floats, hazard_m: float, collision_m: float, nearest_m: float, found: NDArray[np.intp]
) -> tuple[int, int, float]:
    """Pairs of N UAVs that are close to each other in a tick, in which everyone moves straight; exactly.

    Distances are those of the closest approach within the tick, and no less than those of the boxes around both
    segments. So a sweep along x that leaves out distant boxes finds what a comparison of all pairs would.

    Args:
        before: (N, 4), states at the beginning of the tick; NaN: the UAV has no segment, so it approaches nobody.
        after: (N, 4), states at its end; NaN: the UAV is left out.
        hazard_m: distance for the number of near pairs. collision_m: distance for pairs that touch.
        nearest_m: a bound: pairs farther apart than this need not be found for the least distance.
        found: (R, 2), written: the pairs i < j that touch, ascending; if they are more than R, any R of them.

    Returns:
        The number of pairs at most `hazard_m` apart at the end; the number of pairs whose closest approach is less than
        `collision_m`, which may be more than R; the least closest approach of all, m, or `nearest_m` if that is less.
    """
    hazard, collision, nearest = hazard_m * hazard_m, collision_m * collision_m, nearest_m * nearest_m
    first, last = before[:, state.POSITION], after[:, state.POSITION]
    low, high = np.fmin(first, last), np.fmax(first, last)
    present = np.flatnonzero(~np.isnan(last).any(axis=-1))
    order = present[np.argsort(low[present, state.X], kind="stable")]
    few = len(order) <= FEW
    left, right = np.triu_indices(len(order), 1) if few else (np.arange(len(order) - 1), np.arange(1, len(order)))
    near, touching = 0, [np.zeros((0, 2), dtype=np.intp)]
    while len(left):  # places in the order; next, each left one with the one after its right one
        i, j = order[left], order[right]
        gap = np.maximum(np.maximum(low[j] - high[i], low[i] - high[j]), 0.0)
        gap *= gap
        box, reach = gap[:, state.X] + gap[:, state.Y], max(hazard, collision, nearest)
        close = ~(box > reach)
        i, j = i[close], j[close]
        apart = last[j] - last[i]
        squared = np.maximum(state.approach(first[j] - first[i], apart), box[close])
        near += int(np.count_nonzero(state.dot(apart, apart) <= hazard))
        nearest = float(np.fmin.reduce(squared, initial=nearest))  # NaN is near nobody
        touch = squared < collision
        touching.append(np.sort(np.stack([i[touch], j[touch]], axis=-1)))
        ahead = ~(gap[:, state.X] > reach) & (right < len(order) - 1)
        left, right = (left[:0], right[:0]) if few else (left[ahead], right[ahead] + 1)
    all_touching = np.concatenate(touching)
    all_touching = all_touching[np.lexsort(all_touching.T[::-1])]
    found[: len(all_touching)] = all_touching[: len(found)]
    return near, len(all_touching), math.sqrt(nearest)
