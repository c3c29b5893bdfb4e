"""Nearest point to a wanted one in an intersection of half-planes and a disc, for collision avoidance.

The program of two variables is solved exactly and incrementally: half-planes are added one by one, and if the current
point violates the next one, the new point is on its edge (de Berg et al., Computational Geometry, ch. 4). If no point
satisfies all, the bounds are relaxed by the least amount for which half-planes and disc meet; the longer its normal,
the less a half-plane moves. By Helly's theorem convex sets of the plane have a common point if every three have one, so
that amount is the largest that any three need.
"""

from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Floats

PARALLEL = 1e-12  # sine of the angle below which two edges do not meet; as in halfplanes.c
EASE = 1e-9  # relaxation beyond the least amount, relative to 1 + that amount
SAME = 1e-16  # ‖n_i − n_j‖² / ‖n_i‖‖n_j‖ below which one half-plane contains the other


def nearest(wanted: Floats, normals: Floats, bounds: Floats, limit: float, found: Floats, missing: Floats) -> None:
    """Find, for each of M rows, the point a nearest to `wanted` with n_k·a ≥ b_k for K half-planes, and ‖a‖ ≤ limit.

    Args:
        wanted: (M, 2); a row that is not finite is returned as NaN. normals: (M, K, 2), whose length is the
            weight of a half-plane if not all can be satisfied; one of length 0, or not finite, is ignored.
        bounds: (M, K). found: (M, 2), written. missing: (M,), written: 0, or if no point satisfies all half-planes, the
            least possible value of the largest b_k − n_k·a; then `found` is the nearest of the points that attain it.
    """
    with np.errstate(all="ignore"):
        length = np.sqrt(normals[..., 0] * normals[..., 0] + normals[..., 1] * normals[..., 1])
        x = normals[..., 0] / length
        y = normals[..., 1] / length
        bound = bounds / length
        asks = np.isfinite(length) & np.isfinite(x) & np.isfinite(y) & np.isfinite(bound)
        x = np.where(asks, x, 0.0)
        y = np.where(asks, y, 0.0)
        bound = np.where(asks, bound, -np.inf)
        length = np.where(asks, length, 1.0)
        point, feasible = project(wanted, x, y, bound, np.full(len(wanted), limit))
        missing[:] = 0.0
        found[:] = point
        if not feasible.all():
            rows = np.flatnonzero(~feasible)
            x = x[rows]
            y = y[rows]
            bound = bound[rows]
            length = length[rows]
            missing[rows] = need = _needed(x * length, y * length, bound * length, length, limit)
            eased = bound - (need + EASE * (1.0 + need))[:, None] / length
            found[rows] = project(wanted[rows], x, y, eased, np.full(len(rows), limit))[0]
        found[~np.isfinite(wanted).all(axis=-1)] = np.nan


def project(wanted: Floats, x: Floats, y: Floats, bound: Floats, limit: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """The nearest points (M, 2) for unit normals (M, K) within limits (M,), and a mask of the rows that have one."""
    length = np.sqrt(wanted[:, 0] * wanted[:, 0] + wanted[:, 1] * wanted[:, 1])
    scale = np.where(length > limit, limit / length, 1.0)
    a_x, a_y = wanted[:, 0] * scale, wanted[:, 1] * scale
    feasible = np.ones(len(wanted), dtype=bool)
    for k in range(bound.shape[1]):
        rows = np.flatnonzero(feasible & (x[:, k] * a_x + y[:, k] * a_y < bound[:, k]))
        if not len(rows):
            continue
        n_x = x[rows, k]
        n_y = y[rows, k]
        b = bound[rows, k]
        room = limit[rows] * limit[rows] - b * b
        high = np.sqrt(np.where(room > 0.0, room, 0.0))
        low = -high
        meets = room >= 0.0
        if k:  # s: coordinate along the edge, from its point nearest to the origin
            o_x, o_y = x[rows, :k], y[rows, :k]
            sine = n_x[:, None] * o_y - n_y[:, None] * o_x
            cosine = n_x[:, None] * o_x + n_y[:, None] * o_y
            asked = bound[rows, :k] - b[:, None] * cosine
            at = asked / sine
            low = np.maximum(low, np.where(sine > PARALLEL, at, -np.inf).max(axis=1))
            high = np.minimum(high, np.where(sine < -PARALLEL, at, np.inf).min(axis=1))
            # A parallel one of the same direction is satisfied already.
            against = (np.abs(sine) <= PARALLEL) & (cosine < 0.0)
            meets &= ~(against & (asked > 0.0)).any(axis=1) & (low <= high)
        s = np.minimum(np.maximum(n_x * wanted[rows, 1] - n_y * wanted[rows, 0], low), high) + 0.0  # no −0
        a_x[rows[meets]] = (n_x * b - n_y * s)[meets]
        a_y[rows[meets]] = (n_y * b + n_x * s)[meets]
        feasible[rows[~meets]] = False
    return np.stack([a_x, a_y], axis=-1), feasible


def _needed(x: Floats, y: Floats, bound: Floats, length: Floats, limit: float) -> Floats:
    """The least relaxation of the bounds of a row for which its half-planes meet in the disc, (M,)."""
    need = np.maximum((bound - limit * length).max(axis=1), 0.0)
    i, j, first, second, third = _chosen(bound.shape[1])
    if len(i):  # two and the disc: the best point is on the circle, where both are violated equally
        m_x = x[:, i] - x[:, j]
        m_y = y[:, i] - y[:, j]
        apart = bound[:, i] - bound[:, j]
        squared, inner = m_x * m_x + m_y * m_y, x[:, i] * x[:, j] + y[:, i] * y[:, j]
        both = bound[:, j] - limit * inner / length[:, i] > bound[:, i] - limit * length[:, i]
        both &= bound[:, i] - limit * inner / length[:, j] > bound[:, j] - limit * length[:, j]
        room = limit * limit - apart * apart / squared
        reached = (x[:, i] * m_x + y[:, i] * m_y) * (apart / squared) + np.abs(y[:, i] * m_x - x[:, i] * m_y) * np.sqrt(
            np.where(room > 0.0, room, 0.0) / squared
        )
        need = _most(need, bound[:, i] - reached, both & (squared > SAME * (length[:, i] * length[:, j])))
    if len(first):  # three whose normals surround the origin
        a = x[:, second] * y[:, third] - y[:, second] * x[:, third]
        b = x[:, third] * y[:, first] - y[:, third] * x[:, first]
        c = x[:, first] * y[:, second] - y[:, first] * x[:, second]
        total = a + b + c
        of_lengths = length[:, second] * length[:, third] + length[:, third] * length[:, first]
        of_lengths += length[:, first] * length[:, second]
        around = ((a >= 0.0) & (b >= 0.0) & (c >= 0.0)) | ((a <= 0.0) & (b <= 0.0) & (c <= 0.0))
        missed = (a * bound[:, first] + b * bound[:, second] + c * bound[:, third]) / total
        need = _most(need, missed, around & (np.abs(total) > PARALLEL * of_lengths))
    return need


def _most(need: Floats, candidates: Floats, which: NDArray[np.bool_]) -> Floats:
    largest: Floats = np.maximum(need, np.where(which & (candidates > 0.0), candidates, 0.0).max(axis=1))
    return largest


@cache
def _chosen(count: int) -> tuple[NDArray[np.intp], ...]:
    """Indices of all pairs i < j, and of all triples i < j < k."""
    triples = np.array([*combinations(range(count), 3)], dtype=np.intp).reshape(-1, 3)
    return *np.triu_indices(count, 1), *triples.T
