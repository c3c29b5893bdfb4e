"""Nearest point to a wanted one in an intersection of half-spaces and a ball, or in the plane of half-planes and a
disc, for collision avoidance.

Half-spaces are added one by one. If the current point violates the next one, the new point is in its face, where the
others are half-planes and the ball is a disc: a program of two variables, see `halfplanes`. If no point satisfies all,
the least relaxation of the bounds is found by bisection.
"""

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import halfplanes, state
from meanflock.kernels.halfplanes import EASE, PARALLEL, project
from meanflock.kernels.state import Floats

HALVINGS = 52  # of the bisection: as many as a float64 has digits


def nearest(wanted: Floats, normals: Floats, bounds: Floats, limit: float, found: Floats, missing: Floats) -> None:
    """Find, for each of M rows, the point a nearest to `wanted` with n_k·a ≥ b_k for K half-spaces, and ‖a‖ ≤ limit.

    Args:
        wanted: (M, d); a row that is not finite is returned as NaN. normals: (M, K, d), whose length is the
            weight of a half-space if not all can be satisfied; one of length 0, or not finite, is ignored.
        bounds: (M, K). found: (M, d), written. missing: (M,), written: 0, or if no point satisfies all half-spaces, the
            least possible value of the largest b_k − n_k·a; then `found` is the nearest of the points that attain it.
    """
    if wanted.shape[1] == 2:
        halfplanes.nearest(wanted, normals, bounds, limit, found, missing)
        return
    with np.errstate(all="ignore"):
        length = state.length(normals)
        unit, bound = normals / length[..., None], bounds / length
        asks = np.isfinite(length) & np.isfinite(unit).all(axis=-1) & np.isfinite(bound)
        unit, bound = np.where(asks[..., None], unit, 0.0), np.where(asks, bound, -np.inf)
        length = np.where(asks, length, 1.0)
        found[...], feasible = _project(wanted, unit, bound, limit)
        missing[:] = 0.0
        if not feasible.all():
            rows = np.flatnonzero(~feasible)
            wanted_here, unit, bound, length = wanted[rows], unit[rows], bound[rows], length[rows]
            missing[rows] = need = _needed(wanted_here, unit, bound, length, limit)
            eased = bound - (need + EASE * (1.0 + need))[:, None] / length
            found[rows] = _project(wanted_here, unit, eased, limit)[0]
        found[~np.isfinite(wanted).all(axis=-1)] = np.nan


def _project(wanted: Floats, unit: Floats, bound: Floats, limit: float) -> tuple[Floats, NDArray[np.bool_]]:
    """The nearest points (M, 3) for unit normals (M, K, 3), and a mask of the rows that have one."""
    length = state.length(wanted)
    a = wanted * np.where(length > limit, limit / length, 1.0)[:, None]
    feasible = np.ones(len(wanted), dtype=bool)
    for k in range(bound.shape[1]):
        rows = np.flatnonzero(feasible & (state.inner(unit[:, k], a) < bound[:, k]))
        if not len(rows):
            continue
        n, b, others = unit[rows, k], bound[rows, k], unit[rows, :k]
        room = limit * limit - b * b
        e, f = _axes_of_face(n)
        cosine = state.inner(n[:, None], others)
        asked = bound[rows, :k] - b[:, None] * cosine
        m_x, m_y = state.inner(e[:, None], others), state.inner(f[:, None], others)
        sine = np.sqrt(m_x * m_x + m_y * m_y)
        parallel = sine <= PARALLEL  # one of the same direction is satisfied already
        meets = (room >= 0.0) & ~(parallel & (cosine < 0.0) & (asked > 0.0)).any(axis=1)
        m_x, m_y = np.where(parallel, 0.0, m_x / sine), np.where(parallel, 0.0, m_y / sine)
        asked = np.where(parallel, -np.inf, asked / sine)
        in_face = np.stack([state.inner(wanted[rows], e), state.inner(wanted[rows], f)], axis=-1)
        at, fits = project(in_face, m_x, m_y, asked, np.sqrt(np.where(room > 0.0, room, 0.0)))
        meets &= fits
        a[rows[meets]] = (n * b[:, None] + (e * at[:, :1] + f * at[:, 1:]))[meets]
        feasible[rows[~meets]] = False
    return a, feasible


def _axes_of_face(n: Floats) -> tuple[Floats, Floats]:
    """Unit vectors of the plane at right angles to unit vectors (M, 3), (M, 3) each.

    Duff and others, Building an orthonormal basis, revisited, Journal of Computer Graphics Techniques 6(1), 2017.
    """
    x, y, z = state.parts(n)
    sign = np.where(z >= 0.0, 1.0, -1.0)
    across = -1.0 / (sign + z)
    both = x * y * across
    e = np.stack([1.0 + sign * x * x * across, sign * both, -sign * x], axis=-1)
    return e, np.stack([both, sign + y * y * across, -y], axis=-1)


def _needed(wanted: Floats, unit: Floats, bound: Floats, length: Floats, limit: float) -> Floats:
    """The least relaxation of the bounds of a row for which its half-spaces meet in the ball, (M,)."""
    low = np.maximum((bound * length - limit * length).max(axis=1), 0.0)
    high = np.maximum((bound * length).max(axis=1), low)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        _, feasible = _project(wanted, unit, bound - middle[:, None] / length, limit)
        low, high = np.where(feasible, low, middle), np.where(feasible, middle, high)
    return high
