"""Who is near whom: pairs of a row and another UAV, and sums over the pairs of a row."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.state import VX, VY, Plane, Rows, States, X, Y

Floats = NDArray[np.float64]


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


def near(own: States, known: States, uavs: NDArray[np.integer], range_m: float) -> Near:
    """The pairs no more than `range_m` apart.

    Args:
        own: (M, 4). known: (M, N, 4), where each row believes all others. uavs: (M,), the numbers of the rows.
    """
    x, y = own[:, X, None] - known[..., X], own[:, Y, None] - known[..., Y]
    squared = x * x + y * y
    squared[np.arange(len(own)), uavs] = np.inf
    row, other = np.nonzero(squared <= range_m * range_m)
    apart = np.stack([x[row, other], y[row, other]], axis=-1)
    closing = own[row, VX : VY + 1] - known[row, other, VX : VY + 1]
    distance = np.sqrt(squared[row, other])
    away = apart / np.maximum(distance, 1e-9)[:, None]
    if (one_place := distance < 1e-9).any():
        right = np.where(uavs[row] > other, 1.0, -1.0)
        away[one_place] = np.stack([right, np.zeros_like(right)], axis=-1)[one_place]
    return Near(row, other, apart, closing, distance, away)


def summed(row: NDArray[np.intp], vectors: Plane, rows: int) -> Plane:
    """Sums of vectors (P, 2) by row, (rows, 2), added in the order in which they stand."""
    return np.stack([np.bincount(row, vectors[:, axis], rows) for axis in range(state.AXES)], axis=-1)
