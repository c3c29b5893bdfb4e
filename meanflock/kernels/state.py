"""The only definition of a UAV's state: s = [x, y, vx, vy], metres and m/s, origin at the destination.

Every array of states has shape `(..., 4)`; leading axes are free. Index with the names below, never with numbers.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

SIZE = 4
X, Y, VX, VY = range(SIZE)
POSITION = slice(0, 2)  # r, metres
VELOCITY = slice(2, 4)  # v, m/s
AXES = 2  # the plane of flight: x and y

Floats: TypeAlias = NDArray[np.float64]  # any shape
Mask: TypeAlias = NDArray[np.bool_]  # any shape
States: TypeAlias = NDArray[np.float64]  # (..., 4)
Vectors: TypeAlias = NDArray[np.float64]  # (..., axes): accelerations, velocities, positions
Rows: TypeAlias = NDArray[np.float64]  # (...,): one number a UAV


def dot(first: NDArray[np.float64], second: NDArray[np.float64]) -> Rows:
    """Inner product over the last axis, `(...,)`.

    Products first, then NumPy's pairwise sum: its order is the same on every machine and for any number of rows,
    unlike that of a BLAS.
    """
    products: Rows = first * second
    if products.shape[-1] == AXES:  # faster than `reduce`, which starts at 0: without + 0.0, −0 could result
        return products[..., 0] + products[..., 1] + 0.0
    return np.add.reduce(products, axis=-1)


def speed(states: States) -> Rows:
    """‖v‖ in m/s, shape `(...,)`."""
    return np.sqrt(states[..., VX] * states[..., VX] + states[..., VY] * states[..., VY])


def norm(states: States) -> Rows:
    """‖s‖ as the paper prints it, mixing metres and m/s, shape `(...,)`; the destination test uses it."""
    return np.sqrt(dot(states, states))


def approach(first: Vectors, last: Vectors) -> Rows:
    """Least squared distance to the origin of points that move straight from `first` to `last`, `(..., 2)`; `(...,)`.

    NaN where a point has no beginning or no end.
    """
    step = last - first
    before = dot(first, step)
    after = dot(last, step)
    length = dot(step, step)
    ends = np.minimum(dot(first, first), dot(last, last))
    passing = (before < 0.0) & (after > 0.0)  # the nearest point is between the ends
    share = np.divide(-before, length, out=np.zeros_like(before), where=passing)
    nearest = first + share[..., None] * step
    return np.where(passing, np.minimum(ends, dot(nearest, nearest)), ends)
