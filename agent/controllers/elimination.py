"""Solutions and products of many small matrices, in new arrays; see kernels/elimination.py."""

import numpy as np

from meanflock import kernels
from meanflock.swarm.state import Floats


def solve(matrices: Floats, rights: Floats) -> Floats:
    """X of A X = B, for A (M, n, n) and B (M, n, k): (M, n, k); not finite if a matrix is singular."""
    found = np.empty(rights.shape)
    kernels.solve(np.ascontiguousarray(matrices), np.ascontiguousarray(rights), found)
    return found


def product(left: Floats, right: Floats) -> Floats:
    """Matrix products (M, n, k) of (M, n, m) or (n, m) with (M, m, k) or (m, k); (1, n, k) of two single ones."""
    one, other = (np.ascontiguousarray(each if each.ndim == 3 else each[None]) for each in (left, right))
    found = np.empty((max(len(one), len(other)), one.shape[1], other.shape[2]))
    kernels.multiply(one, other, found)
    return found
