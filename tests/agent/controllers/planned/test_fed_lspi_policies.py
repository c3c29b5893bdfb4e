"""Policy iteration against the linear-quadratic regulator, whose best gains solve a Riccati equation."""

import numpy as np
import pytest

from meanflock.agent.controllers.planned import fed_lspi as lspi

DT, DISCOUNT = 0.1, 0.95


def riccati(drag: float, push: float = 0.0) -> tuple[float, float, float]:
    """(k1, k2, k3) of one axis: v' = v + dt(u − c0 v + d), p' = p + dt v', cost p² + ½v² + ½u² discounted by γ."""
    damped = 1.0 - drag * DT
    a = np.array([[1.0, DT * damped, DT * DT * push], [0.0, damped, DT * push], [0.0, 0.0, 1.0]])
    b = np.array([[DT * DT], [DT], [0.0]])
    q, value = np.diag([1.0, 0.5, 0.0]), np.zeros((3, 3))
    for _ in range(5000):
        gain = DISCOUNT * np.linalg.solve(0.5 + DISCOUNT * b.T @ value @ b, b.T @ value @ a)
        value = q + DISCOUNT * a.T @ value @ a - DISCOUNT * a.T @ value @ b @ gain
    return tuple(gain[0].tolist())  # type: ignore[return-value]


def observed(rows: int, ticks: int, drag: float, push: tuple[float, float], noise: float) -> tuple[np.ndarray, ...]:
    """M1 and M2 of rows that fly with the first gains and perturbed inputs."""
    draw = np.random.default_rng(3)
    gains = np.tile([0.3, 1.0, 0.0, 0.0], (rows, 1))
    squares, steps = np.zeros((rows, 14, 14)), np.zeros((rows, 14, 9))
    error = np.zeros((rows, 2, 2))
    for _ in range(ticks):
        given = lspi.inputs(gains, error) + 0.3 * draw.standard_normal((rows, 2))
        v = error[..., 1] + DT * (given - drag * error[..., 1] + push)
        v += noise * np.sqrt(DT) * draw.standard_normal((rows, 2))
        then = np.stack([error[..., 0] + DT * v, v], axis=-1)
        first, second = lspi.seen(error, given, then)
        squares, steps, error = squares + first, steps + second, then
    return squares, steps


def improved(squares: np.ndarray, steps: np.ndarray, rounds: int = 12) -> np.ndarray:
    gains = np.tile([0.3, 1.0, 0.0, 0.0], (len(squares), 1))
    for _ in range(rounds):
        gains = lspi.improve(gains, squares, steps, DISCOUNT, 2.0, 0.3)
    return gains


@pytest.mark.parametrize(("drag", "push"), [(0.1, (0.285, -0.02)), (0.3, (1.2, 0.4)), (0.0, (0.0, -0.7))])
def test_without_noise_the_best_gains_are_found(drag: float, push: tuple[float, float]) -> None:
    gains = improved(*observed(1, 60, drag, push, 0.0))[0]
    k1, k2, along_x = riccati(drag, push[0])
    assert gains == pytest.approx([k1, k2, along_x, riccati(drag, push[1])[2]], rel=1e-3, abs=1e-3)


def test_a_step_changes_gains_by_at_most_its_limits() -> None:
    squares, steps = observed(4, 300, 0.3, (2.5, -2.5), 0.1)
    before = np.tile([0.1, 5.0, -1.0, 1.0], (4, 1))
    after = lspi.improve(before, squares, steps, DISCOUNT, 1.5, 0.2)
    assert (after[:, 0] == 0.1 * 1.5).all()
    assert (after[:, 1] == 5.0 / 1.5).all()
    assert np.abs(after[:, 2:] - before[:, 2:]).max() <= 0.2 * (1 + 1e-12)


def test_a_uav_without_usable_observations_keeps_its_gains() -> None:
    gains = np.tile([0.3, 1.0, 0.0, 0.0], (3, 1))
    squares, steps = np.zeros((3, 14, 14)), np.zeros((3, 14, 9))
    squares[1], steps[2] = np.inf, np.nan
    with np.errstate(all="ignore"):
        after = lspi.improve(gains, squares, steps, DISCOUNT, 2.0, 0.3)
    assert (after[1:] == gains[1:]).all()
    assert np.isfinite(after).all()


def test_absurd_gains_are_flown_at_their_bounds() -> None:
    error = np.ones((1, 2, 2))
    assert np.abs(lspi.inputs(np.full((1, 4), 1e8), error)).max() <= 23.0
