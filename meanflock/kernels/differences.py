"""The mean difference of the velocities of all pairs of UAVs."""

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels import state
from meanflock.kernels.state import Floats

FEW = 100  # UAVs up to which all N² differences are one sum in double precision
# Largest relative error for more than FEW UAVs. No UAV is farther from the mean velocity than it is from the others on
# average, so the mean distance from it is at most the result. A difference is wrong by at most 2⁻²⁴ (‖u_i‖ + ‖u_j‖),
# because the velocities u relative to the mean are rounded, and by 3 · 2⁻²⁴ of itself: together 5 · 2⁻²⁴. In flights
# these errors cancel to some 10⁻⁹.
ALIGNMENT_ERROR = 3e-7


def alignment(states: Floats) -> float:
    """The mean over all N² pairs of UAVs `(N, 4)` of ‖v_j − v_i‖, m/s; 0 of no UAV.

    Of more than `FEW` UAVs it is in single precision, see `ALIGNMENT_ERROR`; infinite or NaN beyond 10¹⁸ m/s.
    """
    n, columns = len(states), np.ascontiguousarray(state.velocity(states).T)
    if n <= FEW:
        difference = columns[:, :, None] - columns[:, None, :]
        return float(np.add.reduce(np.sqrt(state.squared(difference)).ravel())) / max(1, n * n)
    columns -= (np.add.reduce(columns, axis=-1) / n)[:, None]
    return 2.0 * _sum(columns.astype(np.float32)) / (float(n) * float(n))


def _sum(columns: NDArray[np.float32]) -> float:
    """Σ_{i < j} ‖u_j − u_i‖ of velocities (axes, N) relative to their mean."""
    sums = np.zeros(columns.shape[1])  # of each j
    for i in range(columns.shape[1] - 1):
        difference = columns[:, i + 1 :] - columns[:, i, None]
        sums[i + 1 :] += np.sqrt(state.squared(difference))
    return float(np.add.reduce(sums))
