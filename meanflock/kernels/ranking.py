"""The nearest few of many objects, for each row."""

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import state
from meanflock.kernels.state import Floats, Mask, Rows, States, Vectors

NEVER_NEARER_M = 1e-3  # distance along x assumed for two UAVs at one place; the lower number is on the left


def closest(distance: Floats, reach: float, found: NDArray[np.intp]) -> int:
    """Find the objects within reach of each row, nearest first, ties in their order.

    Args:
        distance: (M, N); NaN is out of every reach.
        found: (M, K), written: numbers of the K nearest objects, −1 where there are fewer.

    Returns:
        The largest number of objects that a row has found.
    """
    within = distance <= reach
    most = found.shape[1]
    which = np.argsort(np.where(within, distance, np.nan), axis=1, kind="stable")[:, :most]
    found[:] = -1
    found[:, : which.shape[1]] = np.where(np.take_along_axis(within, which, axis=1), which, -1)
    return min(most, int(within.sum(axis=1).max(initial=0)))


def neighbours(
    own: States,
    others: Floats,
    uavs: NDArray[np.intp],
    reach: float,
    away: Vectors,
    closing: Vectors,
    squared: Rows,
    found: NDArray[np.intp],
) -> int:
    """Find the UAVs within reach of each row, nearest first, ties by number, and where they are.

    Args:
        own: (M, 2d), states of the rows. others: (M, 2d, N), states of all UAVs known to each row.
        uavs: (M,), numbers of the rows. reach: squared distance, m².
        away: (M, K, d), written: own positions minus those of the K nearest UAVs, m.
        closing: (M, K, d), written: own velocities minus theirs, m/s. squared: (M, K), written: of `away`, m².
        found: (M, K), written: their numbers, −1 where there are fewer; then the other numbers have no meaning.

    Returns:
        The largest number of UAVs that a row has found.
    """
    rows, axes = np.arange(len(own)), state.axes(own)
    distance = state.squared([own[:, axis, None] - others[:, axis] for axis in range(axes)])
    distance[rows, uavs] = np.nan
    count = closest(distance, reach, found)
    apart = own[:, None] - np.swapaxes(others, 1, 2)[rows[:, None], found]
    away[:], closing[:] = apart[..., :axes], apart[..., axes:]
    squared[:] = state.squared(state.parts(away))
    move_apart(away, squared, found >= 0, uavs[:, None] < found)
    return count


def move_apart(away: Vectors, squared: Rows, present: Mask, left: Mask | bool) -> None:
    """Move UAVs that are at the place of an object, in arrays that are written.

    Args:
        away: (M, K, d), from the objects to the UAVs, m. squared: (M, K), of `away`, m². present: (M, K), mask of the
            objects that count. left: (M, K), whether a UAV is left of an object, else it is right.
    """
    same = present & (squared < NEVER_NEARER_M * NEVER_NEARER_M)
    if same.any():
        away[same] = 0.0
        away[same, 0] = np.where(np.broadcast_to(left, same.shape)[same], -NEVER_NEARER_M, NEVER_NEARER_M)
        squared[same] = NEVER_NEARER_M * NEVER_NEARER_M
