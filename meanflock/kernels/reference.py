"""NumPy form of the kernels, which is their definition; it runs if there is no compiler.

Arrays are C-contiguous float64 unless a function says otherwise. Rows are independent, to the last bit.
"""

import numpy as np

from meanflock.kernels.all_pairs import pairs
from meanflock.kernels.budget import interpolate, waves
from meanflock.kernels.differences import alignment
from meanflock.kernels.elimination import multiply, solve
from meanflock.kernels.fading import fade, poisson, send
from meanflock.kernels.halfspaces import nearest
from meanflock.kernels.links import pick
from meanflock.kernels.mean_field.learn import learn, prepare
from meanflock.kernels.mean_field.separation import repel
from meanflock.kernels.motion import move, reached
from meanflock.kernels.quadrotor import fly
from meanflock.kernels.ranking import closest, neighbours
from meanflock.kernels.state import Floats
from meanflock.kernels.wire import read, write

__all__ = [
    "BACKEND",
    "alignment",
    "closest",
    "columns",
    "fade",
    "fly",
    "interpolate",
    "largest",
    "learn",
    "move",
    "multiply",
    "nearest",
    "neighbours",
    "pairs",
    "pick",
    "poisson",
    "prepare",
    "reached",
    "read",
    "repel",
    "send",
    "solve",
    "waves",
    "write",
]

BACKEND = "numpy"


def largest(numbers: Floats) -> float:
    """The largest of all |numbers|, 0 of none; NaN if one of them is NaN."""
    return float(np.abs(numbers).max(initial=0.0))


def columns(left: Floats, right: Floats | None, out: Floats, first: int) -> float:
    """Write the columns of two tables, `left` (M, A) and `right` (M, B), of any strides, to `out` (M, A + B).

    Args:
        right: None if B is 0. first: the required A.

    Returns:
        The largest of all |numbers|; NaN if one of them is NaN.
    """
    right = out[:, :0] if right is None else right
    for table, width in ((left, first), (right, out.shape[1] - first)):
        if table.shape != (len(out), width) or table.dtype != np.float64:
            raise ValueError("columns: not float64 of as many rows and columns as there is room for")
    out[:, :first], out[:, first:] = left, right
    return largest(out)
