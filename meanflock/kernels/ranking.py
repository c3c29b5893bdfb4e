"""The nearest few of many objects, for each row."""

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Floats


def closest(distance: Floats, reach: float, found: NDArray[np.intp]) -> int:
    """Find the objects within reach of each row, nearest first, ties in their order.

    Args:
        distance: (M, N); NaN is out of reach. found: (M, K), written: numbers of the K nearest objects, −1 where there
            are fewer.

    Returns:
        The largest number of objects that a row has found.
    """
    within = distance <= reach
    most = found.shape[1]
    which = np.argsort(np.where(within, distance, np.inf), axis=1, kind="stable")[:, :most]
    found[:] = -1
    found[:, : which.shape[1]] = np.where(np.take_along_axis(within, which, axis=1), which, -1)
    return min(most, int(within.sum(axis=1).max(initial=0)))
