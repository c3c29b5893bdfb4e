"""States of UAVs and lists of their numbers.

`kernels/state.py` defines the columns of a state, because compiled code needs them first; other packages import them
from here.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import (  # noqa: F401
    Floats,
    Mask,
    Rows,
    States,
    Vectors,
    approach,
    at_rest,
    axes,
    cross_squared,
    dot,
    flat,
    inner,
    length,
    norm,
    parts,
    position,
    speed,
    squared,
    squared_halves,
    velocity,
)

NO_UAV: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
PLANE, SPACE = 2, 3  # numbers of axes; code that has a scenario asks it, code that has an array asks that


def in_three(vectors: Vectors) -> Vectors:
    """Vectors (..., d) with three numbers, (..., 3): z is 0 in the plane."""
    if vectors.shape[-1] == SPACE:
        return vectors
    return np.concatenate([vectors, np.zeros((*vectors.shape[:-1], 1))], axis=-1)


BEYOND_SENSE = 1e30  # bound of commands, models and diagnostics: a larger number, or NaN, has diverged


def contains(ascending: NDArray[Any], numbers: NDArray[Any]) -> NDArray[np.bool_]:
    """Mask (K,) of the `numbers` (K,) that occur in an `ascending` array; `np.isin` takes eight times as long."""
    if not len(ascending):
        return np.zeros(len(numbers), dtype=bool)
    place = ascending.searchsorted(numbers)
    found: NDArray[np.bool_] = ascending.take(place, mode="clip") == numbers
    return found


def distinct(numbers: NDArray[Any]) -> NDArray[Any]:
    """Each of `numbers` once, in ascending order; `np.unique` would load NumPy's masked arrays."""
    ascending = np.sort(numbers, axis=None)
    first = np.ones(len(ascending), dtype=bool)
    np.not_equal(ascending[1:], ascending[:-1], out=first[1:])
    return ascending[first]
