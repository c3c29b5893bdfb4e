"""A tick of quadrotors: both forms give the same bits, rows are independent, and only unit attitudes are taken."""

from types import ModuleType

import numpy as np
import pytest

from meanflock.kernels import reference
from meanflock.kernels.quadrotor import ATTITUDE, BODY, Craft

CRAFT = np.array(Craft(0.5, 3.65e-3, 3.68e-3, 7.03e-3, 0.17, 5.57e-6, 1.36e-7, 0.33, 1500.0, 544.0, 46.64, 0.1, 0.002))
STEPS = 20
EXTREME = np.array(
    [(0.0, 0.0, -9.81), (0.0, 0.0, -30.0), (5.0, 0.0, -30.0), (1e29, 0.0, 0.0), (0.0, -1e5, 9.0)]
)  # m/s²


def rows_of(count: int) -> list[np.ndarray]:
    """States, bodies, commands and other accelerations of UAVs in any attitude, the first with extreme commands."""
    draw = np.random.default_rng(count)
    states, wanted, outside = (draw.normal(0.0, 5.0, (count, width)) for width in (6, 3, 3))
    body = draw.normal(0.0, 3.0, (count, BODY))
    body[:, ATTITUDE] /= np.linalg.norm(body[:, ATTITUDE], axis=1, keepdims=True)
    body[:, 7:] = draw.uniform(0.0, 1500.0, (count, 5))
    few = min(count, len(EXTREME))
    wanted[:few] = EXTREME[:few]
    return [states, body, wanted, outside]


def flown(backend: ModuleType, rows: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    moved, turned = np.full(rows[0].shape, 7.0), np.full(rows[1].shape, 7.0)
    backend.fly(CRAFT, *rows, STEPS, moved, turned)
    return moved, turned


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 40])
def test_both_forms_have_the_same_bits(backend: ModuleType, count: int) -> None:
    rows = rows_of(count)
    for one, other in zip(flown(backend, rows), flown(reference, rows), strict=True):
        assert np.isfinite(one).all()
        assert one.tobytes() == other.tobytes()


def test_a_row_is_the_same_alone(backend: ModuleType) -> None:
    rows = rows_of(11)
    together = flown(backend, rows)
    for row in range(11):
        alone = flown(backend, [array[row : row + 1] for array in rows])
        for one, other in zip(together, alone, strict=True):
            assert one[row : row + 1].tobytes() == other.tobytes()


@pytest.mark.parametrize("factor", [0.0, 1.001, np.nan])
def test_an_attitude_that_is_no_unit_quaternion_is_refused_before_anything_is_written(
    backend: ModuleType, factor: float
) -> None:
    rows = rows_of(9)
    rows[1][6, ATTITUDE] *= factor
    moved, turned = np.full((9, 6), 7.0), np.full((9, BODY), 7.0)
    with pytest.raises(ValueError, match="the attitude of row 6 is no unit quaternion"):
        backend.fly(CRAFT, *rows, STEPS, moved, turned)
    assert (moved == 7.0).all()
    assert (turned == 7.0).all()
