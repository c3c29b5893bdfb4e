"""Names beside the points of a picture."""

import numpy as np
import pytest

from meanflock.studies.leaderboard.labels import place

FRAME = np.array([0.0, 0.0, 600.0, 400.0])
SIZE = (70.0, 12.0)


def overlap(one: np.ndarray, other: np.ndarray) -> bool:
    return bool((one[:2] < other[2:]).all() and (other[:2] < one[2:]).all())


@pytest.fixture
def crowd() -> np.ndarray:
    return np.random.default_rng(1).normal((300.0, 200.0), 12.0, (12, 2))


def test_no_name_covers_another_an_error_bar_or_the_legend_or_leaves_the_frame(crowd) -> None:
    boxes = [one.box for one in place(crowd, [SIZE] * len(crowd), FRAME, np.empty((0, 4)))]
    assert [(i, j) for i, a in enumerate(boxes) for j, b in enumerate(boxes[:i]) if overlap(a, b)] == []
    assert all((box[:2] >= FRAME[:2]).all() and (box[2:] <= FRAME[2:]).all() for box in boxes)
    for box in boxes:
        np.testing.assert_allclose(box[2:] - box[:2], SIZE)
    bar = np.array([[200.0, 200.0, 400.0, 200.0]])
    (placed,) = place(np.array([[300.0, 200.0]]), [SIZE], FRAME, bar)
    assert placed.box[1] >= 200.0 or placed.box[3] <= 200.0
    assert not placed.is_far
    legend = np.array([450.0, 350.0, 600.0, 400.0])
    (placed,) = place(np.array([[560.0, 380.0]]), [SIZE], FRAME, np.empty((0, 4)), [legend])
    assert not overlap(placed.box, legend)
