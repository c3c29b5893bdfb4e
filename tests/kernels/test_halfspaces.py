"""The nearest point in half-spaces and a ball: both forms against a judge, the plane, and each other."""

from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize

from meanflock.kernels import reference

LIMIT = 3.0
both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def solved(
    backend: ModuleType, wanted: np.ndarray, normals: np.ndarray, bounds: np.ndarray, limit: float = LIMIT
) -> tuple[np.ndarray, np.ndarray]:
    found, missing = np.full(wanted.shape, 7.0), np.full(len(wanted), 7.0)
    backend.nearest(wanted, normals, bounds, limit, found, missing)
    return found, missing


def programs(seed: int, rows: int, count: int, tight: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    normals = draw.normal(size=(rows, count, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals *= draw.choice([0.5, 1.0, 1.0, 10.0], size=(rows, count, 1))
    bounds = draw.normal(0.0, tight, size=(rows, count)) * np.linalg.norm(normals, axis=-1)
    return draw.normal(0.0, 2.0, size=(rows, 3)), normals, bounds


@pytest.mark.parametrize("tight", [0.5, 2.0])
def test_points_are_those_of_a_judge(backend: ModuleType, tight: float) -> None:
    wanted, normals, bounds = programs(5, 60, 6, tight)
    found, missing = solved(backend, wanted, normals, bounds)
    for row in range(len(wanted)):
        eased = bounds[row] - missing[row] * (1.0 + 1e-9) - 1e-9 * (missing[row] > 0.0)
        assert (normals[row] @ found[row] >= eased - 1e-9).all()
        assert np.linalg.norm(found[row]) <= LIMIT + 1e-9
        if missing[row] == 0.0:  # the nearest of all points
            judge = minimize(
                lambda a, w=wanted[row]: ((a - w) ** 2).sum(),
                np.zeros(3),
                jac=lambda a, w=wanted[row]: 2.0 * (a - w),
                constraints=[
                    LinearConstraint(normals[row], bounds[row]),
                    NonlinearConstraint(lambda a: a @ a, -np.inf, LIMIT**2, jac=lambda a: 2.0 * a),
                ],
                method="SLSQP",
                options={"ftol": 1e-14, "maxiter": 500},
            )
            assert ((found[row] - wanted[row]) ** 2).sum() <= judge.fun + 1e-6
        else:  # the least relaxation of all
            judge = minimize(
                lambda u: u[3],
                np.array([0.0, 0.0, 0.0, np.abs(bounds[row]).max()]),
                jac=lambda u: np.array([0.0, 0.0, 0.0, 1.0]),
                constraints=[
                    LinearConstraint(np.column_stack([normals[row], np.ones(len(bounds[row]))]), bounds[row]),
                    NonlinearConstraint(
                        lambda u: u[:3] @ u[:3], -np.inf, LIMIT**2, jac=lambda u: np.array([*(2.0 * u[:3]), 0.0])
                    ),
                ],
                method="SLSQP",
                options={"ftol": 1e-14, "maxiter": 500},
            )
            assert missing[row] == pytest.approx(judge.fun, abs=1e-6)


@both_forms
@given(st.integers(0, 9), st.integers(0, 12), st.sampled_from([0.3, 1.0, 3.0]), st.integers(0, 2**32 - 1))
def test_both_forms_are_alike_and_rows_independent(
    backend: ModuleType, rows: int, count: int, tight: float, seed: int
) -> None:
    """Some half-spaces are equal, opposite, unused or not finite."""
    wanted, normals, bounds = programs(seed, rows, count, tight)
    draw = np.random.default_rng(seed)
    if count > 1:
        normals[:, 1] = normals[:, 0] * draw.choice([-1.0, 1.0, 0.0, np.nan], size=(rows, 1))
    normals[draw.random((rows, count)) < 0.2] = [0.0, 0.0, -1.0]
    wanted[draw.random(rows) < 0.1] = np.inf
    found, missing = solved(backend, wanted, normals, bounds)
    defined, least = solved(reference, wanted, normals, bounds)
    assert found.tobytes() == defined.tobytes()
    assert missing.tobytes() == least.tobytes()
    for row in range(rows):
        alone, _ = solved(backend, wanted[row : row + 1], normals[row : row + 1], bounds[row : row + 1])
        assert alone.tobytes() == found[row : row + 1].tobytes()


def test_a_level_program_is_that_of_the_plane(backend: ModuleType) -> None:
    wanted, normals, bounds = programs(3, 200, 4)
    wanted[:, 2] = normals[:, :, 2] = 0.0
    found, missing = solved(backend, wanted, normals, bounds)
    flat, least = (np.ascontiguousarray(part[..., :2]) for part in (wanted, normals))
    there, more = solved(backend, flat, least, bounds)
    np.testing.assert_allclose(found[:, :2], there, atol=1e-6)
    np.testing.assert_allclose(found[:, 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(missing, more, atol=1e-9)
    assert (missing > 0.0).any()
    assert (missing == 0.0).any()


def test_a_case_by_hand(backend: ModuleType) -> None:
    """Above z = 1, and from there on the side x ≥ 2: the corner of both."""
    normals, bounds = np.array([[[0.0, 0.0, 2.0], [3.0, 0.0, 0.0]]]), np.array([[2.0, 6.0]])
    found, missing = solved(backend, np.array([[0.5, 0.25, 0.0]]), normals, bounds)
    np.testing.assert_allclose(found, [[2.0, 0.25, 1.0]], atol=1e-12)
    assert missing == 0.0
