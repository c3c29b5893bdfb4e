"""Many small systems of linear equations at once; the bits of each do not depend on the others.

No BLAS is used, because its order of summation depends on the machine and on the number of systems.
"""

import numpy as np

from meanflock.kernels.state import Floats


def solve(matrices: Floats, rights: Floats, found: Floats) -> None:
    """Solve A X = B for each of M systems, by Gaussian elimination with partial pivoting.

    Args:
        matrices: (M, n, n). rights: (M, n, k). found: (M, n, k), written: X; not finite if a matrix is singular.
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
        found[:] = both[:, :, size:]
        for k in range(size - 1, 0, -1):
            found[:, :k] -= both[:, :k, k : k + 1] * found[:, k : k + 1]


def multiply(left: Floats, right: Floats, found: Floats) -> None:
    """Matrix products, summed in the order of m.

    Args:
        left: (M, n, m). right: (M, m, k). One of them may be (1, …), for all M. found: (M, n, k), written.
    """
    with np.errstate(all="ignore"):
        np.multiply(left[:, :, 0, None], right[:, 0, None, :], out=found)
        for k in range(1, left.shape[-1]):
            found += left[:, :, k, None] * right[:, k, None, :]
