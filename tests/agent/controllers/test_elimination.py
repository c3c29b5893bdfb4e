"""Many small systems at once: each has its solution, with the bits it has alone."""

import numpy as np
import pytest

from meanflock.agent.controllers.elimination import solve


@pytest.mark.parametrize("size", [1, 2, 9, 14])
def test_solutions_are_those_of_lapack(size: int) -> None:
    draw = np.random.default_rng(size)
    matrices, rights = draw.standard_normal((40, size, size)), draw.standard_normal((40, size, 3))
    expected = np.linalg.solve(matrices, rights)
    scale = np.linalg.cond(matrices)[:, None, None] * np.abs(expected).max(axis=(1, 2), keepdims=True)
    assert (np.abs(solve(matrices, rights) - expected) < 1e-13 * scale).all()
