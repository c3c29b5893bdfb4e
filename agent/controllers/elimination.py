"""Solve many small systems of linear equations at once; the bits of each do not depend on the others.

No BLAS is used, because its order of summation depends on the machine and on the number of systems.
"""

import numpy as np

from meanflock.swarm.state import Floats


def solve(matrices: Floats, rights: Floats) -> Floats:
    """Solve A X = B for each of M systems, by Gaussian elimination with partial pivoting.

    Args:
        matrices: (M, n, n). rights: (M, n, k).

    Returns:
        X, (M, n, k); not finite if a matrix is singular.
    """
    count, size, _ = matrices.shape
    both = np.concatenate([matrices, rights], axis=-1)
    row = np.arange(count)
    with np.errstate(all="ignore"):
        for k in range(size):
            pivot = k + np.argmax(np.abs(both[:, k:, k]), axis=1)
            best = both[row, pivot, k:]
            both[row, pivot, k:] = both[:, k, k:]
            both[:, k, k:] = best / best[:, :1]
            below = both[:, k + 1 :, k : k + 1].copy()
            both[:, k + 1 :, k:] -= below * both[:, k : k + 1, k:]
        found = both[:, :, size:]
        for k in range(size - 1, 0, -1):
            found[:, :k] -= both[:, :k, k : k + 1] * found[:, k : k + 1]
    return found


def product(left: Floats, right: Floats) -> Floats:
    """Matrix products (M, n, k) of (M, n, m) or (n, m) with (M, m, k) or (m, k), summed in the order of m."""
    total = left[..., :, 0, None] * right[..., 0, None, :]
    for k in range(1, left.shape[-1]):
        total += left[..., :, k, None] * right[..., k, None, :]
    return total
