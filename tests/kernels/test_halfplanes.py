"""The nearest point in half-planes and a disc, against an exact solver of quadratic programs."""

from types import ModuleType
from typing import Any

import daqp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from meanflock.kernels import reference

Floats = NDArray[np.float64]

LIMIT = 3.0
TOLERANCE = 1e-6


def solve(backend: ModuleType, wanted: Any, normals: Any, bounds: Any, limit: float = LIMIT) -> tuple[Floats, Floats]:
    rows = len(wanted)
    found, missing = np.full((rows, 2), -7.0), np.full(rows, -7.0)
    count = np.size(bounds) // max(1, rows)
    normals = np.ascontiguousarray(np.reshape(normals, (rows, count, 2)), dtype=float)
    bounds = np.ascontiguousarray(np.reshape(bounds, (rows, count)), dtype=float)
    backend.nearest(np.array(wanted, dtype=float), normals, bounds, limit, found, missing)
    return found, missing


def cases(rows: int, count: int, seed: int) -> tuple[Floats, Floats, Floats]:
    """Random cases, half of them degenerate: twice the same half-plane, back to back, no direction."""
    draw = np.random.default_rng(seed)
    wanted, normals = 2.0 * draw.normal(size=(rows, 2)), draw.normal(size=(rows, count, 2))
    bounds = draw.normal(size=(rows, count)) - 0.7
    if count > 2:
        normals[1::6, 1], bounds[1::12, 1] = normals[1::6, 0], bounds[1::12, 0]
        normals[2::8, 2] = -normals[2::8, 0]
        normals[3::10, 1] = 0.0
        normals[5::14], bounds[5::14] = np.round(normals[5::14]), np.round(bounds[5::14])
    return wanted, normals, bounds


def by_quadratic_program(wanted: Floats, normals: Floats, bounds: Floats) -> Floats:
    """The nearest point; the disc by its tangents at what was found without them, as many as it takes."""
    length = np.linalg.norm(normals, axis=1)
    asks = length > 0.0
    rows, least = normals[asks] / length[asks, None], bounds[asks] / length[asks]
    for _ in range(60):
        upper = np.full(len(rows), 1e30)
        point, _, status, _ = daqp.solve(np.eye(2), -wanted, np.ascontiguousarray(rows), upper, least, primal_tol=1e-12)
        assert status == 1
        if (far := np.linalg.norm(point)) <= LIMIT + 1e-10:
            return np.array(point)
        rows, least = np.vstack([rows, -point / far]), np.append(least, -LIMIT)
    raise AssertionError("tangents do not converge")


def by_linear_program(normals: Floats, bounds: Floats) -> float:
    """The least t with n·a + t ≥ b for all and ‖a‖ ≤ LIMIT, the disc again by tangents."""
    around = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    tangents = np.stack([np.cos(around), np.sin(around)], axis=-1)
    for _ in range(60):
        matrix = np.vstack(
            [np.column_stack([-normals, -np.ones(len(normals))]), np.column_stack([tangents, np.zeros(len(tangents))])]
        )
        limits = np.concatenate([-bounds, np.full(len(tangents), LIMIT)])
        best = linprog([0.0, 0.0, 1.0], matrix, limits, bounds=[(None, None)] * 3)
        assert best.status == 0
        if (length := np.linalg.norm(best.x[:2])) <= LIMIT + 1e-7:
            return float(best.x[2])
        tangents = np.vstack([tangents, best.x[:2] / length])
    raise AssertionError("tangents do not converge")


@pytest.mark.parametrize(("count", "rows"), [(1, 300), (2, 600), (4, 900), (7, 600), (12, 600)])
def test_a_row_is_solved_as_by_an_exact_solver(count: int, rows: int) -> None:
    """The nearest point if all half-planes can be kept, else the least violation; both forms have the same bits."""
    wanted, normals, bounds = cases(rows, count, seed=count)
    found, missing = solve(reference, wanted, normals, bounds)
    assert (np.linalg.norm(found, axis=1) <= LIMIT + 1e-9).all()
    asked = np.where(normals.any(axis=2), bounds, -np.inf)
    worst = (asked - (normals * found[:, None]).sum(axis=2)).max(axis=1, initial=0.0)
    np.testing.assert_allclose(worst, missing, atol=TOLERANCE)
    can = missing <= 0.0
    assert 0 < can.sum() < rows or count == 1
    for row in np.flatnonzero(can):
        exact = by_quadratic_program(wanted[row], normals[row], bounds[row])
        # The distance is what is least; near a corner of almost parallel edges the place is less well determined.
        distances = [np.linalg.norm(one - wanted[row]) for one in (found[row], exact)]
        assert distances[0] == pytest.approx(distances[1], abs=TOLERANCE)
        np.testing.assert_allclose(found[row], exact, atol=1e-4)
    for row in np.flatnonzero(~can)[:50]:
        keeps = normals[row].any(axis=1)
        exact = by_linear_program(normals[row, keeps], bounds[row, keeps])
        assert missing[row] == pytest.approx(exact, abs=TOLERANCE)


def test_of_the_points_that_miss_least_the_nearest_is_chosen(backend: ModuleType) -> None:
    """Two half-planes back to back, 1 apart from each other: all of a line is as good, and wanted is beside it."""
    for along, expected in ((0.4, 0.4), (-0.7, -0.7), (9.0, np.sqrt(LIMIT**2 - 0.25))):
        found, missing = solve(backend, [[9.0, along]], [[1.0, 0.0], [-1.0, 0.0]], [1.0, 0.0])
        np.testing.assert_allclose((*found[0], *missing), (0.5, expected, 0.5), atol=1e-7)


@pytest.mark.parametrize(
    ("normals", "bounds", "found", "missing"),
    [
        ([], [], (2.0, 0.0), 0.0),
        ([[0.0, 0.0]], [5.0], (2.0, 0.0), 0.0),  # no direction: nothing is asked
        ([[np.nan, 1.0], [1.0, np.inf]], [5.0, 5.0], (2.0, 0.0), 0.0),
        ([[-1.0, 0.0]], [np.inf], (2.0, 0.0), 0.0),
        ([[-1e160, 0.0], [0.0, 4.0]], [1.0, 16.0], (0.0, 3.0), 4.0),  # its length is not finite
        ([[0.0, 4.0]], [16.0], (0.0, 3.0), 4.0),  # beyond the disc
    ],
)
def test_cases_worked_by_hand(
    backend: ModuleType, normals: Any, bounds: Any, found: tuple[float, float], missing: float
) -> None:
    came, lacks = solve(backend, [[2.0, 0.0]], normals, bounds)
    np.testing.assert_allclose(came[0], found, atol=2e-4 if missing else 1e-12)
    assert lacks[0] == pytest.approx(missing, abs=1e-12)


def test_a_wish_is_limited_and_there_may_be_no_rows_or_half_planes(backend: ModuleType) -> None:
    np.testing.assert_allclose(solve(backend, [[30.0, 40.0]], [], [])[0], [[1.8, 2.4]])
    assert solve(backend, np.zeros((0, 2)), np.zeros((0, 3, 2)), np.zeros((0, 3)))[0].shape == (0, 2)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_wish_that_is_no_number_spoils_its_own_row_only(backend: ModuleType, bad: float) -> None:
    found, _ = solve(backend, [[bad, 0.0], [1.0, 1.0]], [[[1.0, 0.0]]] * 2, [[0.5]] * 2)
    assert np.isnan(found[0]).all()
    np.testing.assert_array_equal(found[1], [1.0, 1.0])


@pytest.mark.parametrize("count", [0, 1, 2, 3, 6, 10, 17])
def test_both_forms_give_the_same_bits_and_rows_are_alone(count: int) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    wanted, normals, bounds = cases(5000, count, seed=100 + count)
    many = [solve(backend, wanted, normals, bounds) for backend in (compiled, reference)]
    alone = [solve(reference, wanted[k : k + 1], normals[k : k + 1], bounds[k : k + 1]) for k in range(0, 5000, 50)]
    assert [table.tobytes() for table in many[0]] == [table.tobytes() for table in many[1]]
    assert np.concatenate([found for found, _ in alone]).tobytes() == many[1][0][::50].tobytes()
