"""Many small systems at once: each has its solution, with the bits it has alone."""

import numpy as np
import pytest

from meanflock.agent.controllers.elimination import product, solve


@pytest.mark.parametrize("size", [1, 2, 9, 14])
def test_solutions_are_those_of_lapack(size: int) -> None:
    draw = np.random.default_rng(size)
    matrices, rights = draw.standard_normal((40, size, size)), draw.standard_normal((40, size, 3))
    expected = np.linalg.solve(matrices, rights)
    scale = np.linalg.cond(matrices)[:, None, None] * np.abs(expected).max(axis=(1, 2), keepdims=True)
    assert (np.abs(solve(matrices, rights) - expected) < 1e-13 * scale).all()


def test_a_zero_on_the_diagonal_does_no_harm() -> None:
    swap = np.array([[[0.0, 1.0], [2.0, 0.0]]])
    assert solve(swap, np.array([[[3.0], [4.0]]])).tolist() == [[[2.0], [3.0]]]


def test_the_system_of_a_row_has_the_same_bits_among_others() -> None:
    draw = np.random.default_rng(0)
    matrices, rights = draw.standard_normal((25, 14, 14)), draw.standard_normal((25, 14, 9))
    matrices[7] = 0.0  # singular
    together, times = solve(matrices, rights), product(matrices, rights)
    assert not np.isfinite(together[7]).any()
    for row in (slice(k, k + 1) for k in range(25)):
        assert solve(matrices[row], rights[row]).tobytes() == together[row].tobytes()
        assert product(matrices[row], rights[row]).tobytes() == times[row].tobytes()
    assert times == pytest.approx(matrices @ rights)
    assert product(matrices, rights[0]) == pytest.approx(matrices @ rights[0])
