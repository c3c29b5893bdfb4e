"""The mean difference of the velocities of all pairs of UAVs."""

import numpy as np

from meanflock.kernels import mesh, state
from meanflock.kernels.state import Floats

FEW = 100  # UAVs up to which all N² differences are one sum in double precision
MANY = 3000  # UAVs up to which all differences are taken one by one; beyond, most are summed on a mesh
# Largest relative error for more than FEW UAVs. No UAV is farther from the mean velocity than it is from the others on
# average, so the mean distance from it, m, is at most the result.
# - A difference that is taken by itself is wrong by at most 2⁻²⁴ (‖u_i‖ + ‖u_j‖), because the velocities u relative to
#   the mean are rounded, and by 3 · 2⁻²⁴ of itself: together 5 · 2⁻²⁴.
# - One on the mesh is wrong by the error of mesh.py. A spacing of the mesh is 3 m/124, so this is at most 1.5 · 10⁻⁶ m.
# In flights these errors cancel to some 10⁻⁹.
ALIGNMENT_ERROR = 1.5e-6
_WIDE = 3.0  # half the width of the mesh over m: at most a third of the UAVs are outside
_LEAST, _MOST = 1e-15, 1e15  # m/s, of m: differences like these have squares in single precision


def alignment(states: Floats) -> float:
    """The mean over all N² pairs of UAVs `(N, 4)` of ‖v_j − v_i‖, m/s; 0 of no UAV.

    Of more than `FEW` UAVs it is an approximation, see `ALIGNMENT_ERROR`; infinite or NaN beyond 10¹⁸ m/s.
    """
    n, columns = len(states), np.ascontiguousarray(states[:, state.VELOCITY].T)
    if n <= FEW:
        difference = columns[:, :, None] - columns[:, None, :]
        difference *= difference
        return float(np.add.reduce(np.sqrt(difference[0] + difference[1]).ravel())) / max(1, n * n)
    columns -= (np.add.reduce(columns, axis=-1) / n)[:, None]
    return 2.0 * _sum(columns) / (float(n) * float(n))


def _sum(columns: Floats) -> float:
    """Σ_{i < j} ‖u_j − u_i‖ of velocities (2, N) relative to their mean."""
    n = columns.shape[1]
    if n > MANY:
        distance = float(np.add.reduce(np.sqrt(columns[0] * columns[0] + columns[1] * columns[1]))) / n
        if _LEAST < distance < _MOST:
            width = _WIDE * distance
            inside = (np.abs(columns) < width).all(axis=0)
            columns = np.concatenate([columns[:, ~inside], columns[:, inside]], axis=1)
            outside = n - int(np.count_nonzero(inside))
            scale = mesh.EXTENT / width
            among = mesh.distances(columns[:, outside:] * scale + mesh.CENTRE)
            if among is not None:
                return _one_by_one(columns, outside) + among / scale
    return _one_by_one(columns, n - 1)


def _one_by_one(columns: Floats, count: int) -> float:
    """Σ_{i < j} ‖u_j − u_i‖ over the first `count` i of velocities (2, N), in single precision."""
    columns = columns.astype(np.float32)
    sums = np.zeros(columns.shape[1])  # of each j
    for i in range(count):
        difference = columns[:, i + 1 :] - columns[:, i, None]
        difference *= difference
        sums[i + 1 :] += np.sqrt(difference[0] + difference[1])
    return float(np.add.reduce(sums))
