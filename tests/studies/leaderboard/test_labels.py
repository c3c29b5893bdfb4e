"""Names beside points: no name covers another, and a line leads to a name that is far from its point."""

import numpy as np
import pytest

from meanflock.groundstation.plots import plotstyle
from meanflock.studies.leaderboard.labels import Named, label, place

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


def test_a_name_far_from_its_point_has_a_line_to_it(crowd) -> None:
    with plotstyle.style():
        made = plotstyle.figure(6.0, 4.0)
        ax = made.subplots()
        ax.set_xlim(0.0, 600.0)
        ax.set_ylim(0.0, 400.0)
        made.draw_without_rendering()
        label(ax, [Named(f"controller-{k}", x, y, "#222222") for k, (x, y) in enumerate(crowd)])
    boxes = [text.get_window_extent() for text in ax.texts]
    points = ax.transData.transform(crowd)
    gaps = [np.hypot(*(np.clip(p, box.min, box.max) - p)) for p, box in zip(points, boxes, strict=True)]
    assert max(gaps) > 16.0
    assert len(ax.lines) >= sum(gap > 16.0 for gap in gaps)
