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

__all__ = ["BACKEND", "columns", "learn", "nearest", "pairs", "prepare", "read", "repel", "write"]

BACKEND = "numpy"
FEW = 100  # UAVs up to which all N² distances are one sum; as in pairs.c


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


def pairs(
    states: Floats, hazard_m: float, collision_m: float, found: NDArray[np.intp]
) -> tuple[float, int, int, float]:
    """All pairs of N UAVs `(N, 4)` at one instant, exactly.

    Args:
        found: (R, 2), written: the first R pairs i < j closer than `collision_m`, ascending.

    Returns:
        The mean over all N² pairs of ‖v_j − v_i‖, m/s; the number of pairs i < j at most `hazard_m` apart; the number
        of those closer than `collision_m`, which may be more than R; the least distance of all, m, infinite where there
        is no pair.
    """
    n, columns = len(states), np.ascontiguousarray(states.T)
    measure = _few if n <= FEW else _many
    mean, near, touching, least = measure(columns, hazard_m * hazard_m, collision_m * collision_m)
    found[: len(touching)] = touching[: len(found)]
    return mean, near, len(touching), math.sqrt(least)


def _few(columns: Floats, hazard: float, collision: float) -> tuple[float, int, NDArray[np.intp], float]:
    """All pairs as one array: the mean distance of velocities, who is near, which pairs touch, and how near the nearest
    are; distances squared."""
    n = columns.shape[1]
    difference = columns[:, :, None] - columns[:, None, :]
    difference *= difference
    total = np.add.reduce(np.sqrt(difference[2] + difference[3]).ravel())
    first, second = upper = np.triu_indices(n, 1)
    squared = (difference[0] + difference[1])[upper]
    touching = np.flatnonzero(squared < collision)
    near = int(np.count_nonzero(squared <= hazard))
    nearest = float(np.fmin.reduce(squared, initial=math.inf))  # NaN is near nobody
    return float(total) / max(1, n * n), near, np.stack([first[touching], second[touching]], axis=-1), nearest


def _many(columns: Floats, hazard: float, collision: float) -> tuple[float, int, NDArray[np.intp], float]:
    """The same row by row, without an N × N array."""
    n, near, touching, nearest = columns.shape[1], 0, [], math.inf
    rows = np.zeros(n - 1)  # Σ_{j > i} ‖v_j − v_i‖ of each i
    for i in range(n - 1):
        difference = columns[:, i + 1 :] - columns[:, i, None]
        difference *= difference
        rows[i] = np.add.reduce(np.sqrt(difference[2] + difference[3]))
        squared = difference[0] + difference[1]
        near += int(np.count_nonzero(squared <= hazard))
        nearest = min(nearest, float(np.fmin.reduce(squared, initial=math.inf)))
        touching += [(i, i + 1 + j) for j in np.flatnonzero(squared < collision).tolist()]
    mean = 2.0 * float(np.add.reduce(rows)) / (float(n) * float(n))
    return mean, near, np.array(touching, dtype=np.intp).reshape(-1, 2), nearest
