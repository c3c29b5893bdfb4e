"""Numbers in ascending order, as UAVs are named everywhere: a question asked of them in every tick."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def contains(ascending: NDArray[Any], numbers: NDArray[Any]) -> NDArray[np.bool_]:
    """Which of `numbers` (K,) are among those in ascending order, `(K,)`; `np.isin` takes eight times as long."""
    if not len(ascending):
        return np.zeros(len(numbers), dtype=bool)
    place = ascending.searchsorted(numbers)
    found: NDArray[np.bool_] = ascending.take(place, mode="clip") == numbers
    return found


def distinct(numbers: NDArray[Any]) -> NDArray[Any]:
    """Each of `numbers` once, in ascending order; `np.unique` loads NumPy's masked arrays to say the same."""
    ascending = np.sort(numbers, axis=None)
    first = np.ones(len(ascending), dtype=bool)
    np.not_equal(ascending[1:], ascending[:-1], out=first[1:])
    return ascending[first]
