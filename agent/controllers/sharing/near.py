"""Who is near whom: pairs of a row and another UAV, and sums over the pairs of a row."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.state import VX, VY, Floats, Plane, Rows, States, X, Y

NOWHERE_M = 1e-9  # a distance without a direction


class Near(NamedTuple):
    """P pairs, by row and then by number of the other.

    row, other: (P,). apart: (P, 2) own position minus the other's, m. closing: (P, 2) own velocity minus the other's,
    m/s. distance: (P,) m. away: (P, 2) unit vector off the other; where both are in one place, along x, the higher
    number to the right.
    """

    row: NDArray[np.intp]
    other: NDArray[np.intp]
    apart: Plane
    closing: Plane
    distance: Rows
    away: Plane


def near(
    own: States,
    known: States,
    uavs: NDArray[np.integer],
    range_m: float,
    matters: Callable[[Floats, Floats], NDArray[np.bool_]] | None = None,
) -> Near:
    """The pairs no more than `range_m` apart, and of these only such as matter.

    Args:
        own: (M, 4). known: (M, N, 4), where each row believes all others. uavs: (M,), the numbers of the rows.
        matters: says it of squared distances and squared differences of velocity, (M, N) each, m² and m²/s².
    """
    x, y = own[:, X, None] - known[..., X], own[:, Y, None] - known[..., Y]
    squared = x * x + y * y
    squared[np.arange(len(own)), uavs] = np.inf
    chosen = squared <= range_m * range_m
    if matters is not None:
        vx, vy = own[:, VX, None] - known[..., VX], own[:, VY, None] - known[..., VY]
        chosen &= matters(squared, vx * vx + vy * vy)
    row, other = np.nonzero(chosen)
    apart = np.stack([x[row, other], y[row, other]], axis=-1)
    closing = own[row, VX : VY + 1] - known[row, other, VX : VY + 1]
    distance = np.sqrt(squared[row, other])
    away = apart / np.maximum(distance, NOWHERE_M)[:, None]
    if (one_place := distance < NOWHERE_M).any():
        away[one_place] = 0.0
        away[one_place, X] = np.where(uavs[row] > other, 1.0, -1.0)[one_place]
    return Near(row, other, apart, closing, distance, away)


def edges(own: States, discs: Floats) -> tuple[Floats, Floats, Floats]:
    """How far rows (M, 4) are from the edges of discs (K, 3), m, negative inside; and unit vectors off their centres.

    Returns:
        Distance, x and y, (M, K) each.
    """
    x, y = own[:, X, None] - discs[:, 0], own[:, Y, None] - discs[:, 1]
    distance = np.sqrt(x * x + y * y)
    length = np.maximum(distance, NOWHERE_M)
    return distance - discs[:, 2], x / length, y / length


def summed(row: NDArray[np.intp], vectors: Plane, rows: int) -> Plane:
    """Sums of vectors (P, 2) by row, (rows, 2), added in the order in which they stand."""
    return np.stack([np.bincount(row, vectors[:, axis], rows) for axis in range(state.AXES)], axis=-1)
