"""Numbers beside the points of a plot. Points that lie on each other share a block; no two blocks overlap."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from meanflock.results.plots import plotstyle

Floats = NDArray[np.float64]

_SIZE = 6.6  # of the digits, points
_DIGIT_PX, _GAP_PX, _LINE_PX = 5.9, 5.2, 11.5  # of a block: a digit, the gap after a number, a line; at 100 dpi
_COLUMNS = 4  # of a block, at most
_MARKER_PX = 4.5  # half the side of a marker
_TOGETHER_PX = 8.0  # points nearer to the first point of a group belong to it
_FAR_PX = 7.0  # a block farther from its points has a line to them
# Places that are tried around a group
_RING_PX, _RINGS, _DIRECTIONS = 4.0, 40, 32
# Cost of a place, added to its distance in pixels
_ON_A_BLOCK, _ON_A_POINT, _ON_A_LINE = 1e4, 400.0, 12.0
_WAY_OVER_A_BLOCK, _WAY_OVER_A_WAY, _WAY_OVER_A_POINT = 2e3, 600.0, 60.0
_SWEEPS = 5  # rounds in which each block is moved while the others stay


class Numbered(NamedTuple):
    """A point with its number and colour."""

    number: int
    x: float
    y: float
    tone: str


class Block(NamedTuple):
    """A placed block: its box [left, low, right, high], (4,) px, and its way to the point, [x, y, x, y], (4,) px."""

    box: Floats
    way: Floats

    @property
    def is_far(self) -> bool:
        """Returns whether the block needs a line to its point."""
        return math.dist(self.way[:2], self.way[2:]) > _FAR_PX


def number(ax: Axes, points: Sequence[Numbered], lines: Sequence[Floats] = ()) -> list[Block]:
    """Write the numbers into a plot whose limits, size and layout are final.

    Args:
        lines: polylines (K, 2) to avoid, in the plot's coordinates.
    """
    places = ax.transData.transform([(point.x, point.y) for point in points]).reshape(-1, 2)
    pieces = [ax.transData.transform(line) for line in lines if len(line) > 1]
    segments = np.concatenate([np.concatenate([p[:-1], p[1:]], axis=1) for p in pieces] or [np.empty((0, 4))])
    groups = grouped(places)
    cells = [_cell_px(max(len(str(points[member].number)) for member in group)) for group in groups]
    blocks = place(places, groups, cells, np.array(ax.bbox.extents), segments)
    to_axes = ax.transAxes.inverted().transform
    for group, cell, block in zip(groups, cells, blocks, strict=True):
        for at, member in zip(_middles(block.box, cell, len(group)), group, strict=True):
            x, y = to_axes(at)
            text = ax.text(x, y, str(points[member].number), transform=ax.transAxes, color=points[member].tone)
            text.set(ha="center", va="center", fontsize=_SIZE, fontweight="bold", zorder=6, in_layout=False)
            text.set_path_effects([withStroke(linewidth=1.6, foreground="white")])
        if block.is_far:
            (x, *other_x), (y, *other_y) = to_axes(block.way.reshape(2, 2)).T
            way = Line2D([x, *other_x], [y, *other_y], transform=ax.transAxes, color=plotstyle.PALE, linewidth=0.6)
            way.set(zorder=2.5)
            ax.add_line(way).set_in_layout(False)
    return blocks


def grouped(places: Floats) -> list[list[int]]:
    """Indices of points (P, 2) px that lie on each other, in ascending order within a group."""
    groups: list[list[int]] = []
    for point, (x, y) in enumerate(places.tolist()):
        near = (group for group in groups if math.dist(places[group[0]], (x, y)) < _TOGETHER_PX)
        if (group := next(near, None)) is None:
            groups.append([point])
        else:
            group.append(point)
    return groups


def place(
    places: Floats, groups: Sequence[Sequence[int]], cells: Sequence[Floats], frame: Floats, segments: Floats
) -> list[Block]:
    """The place of the block of each group, all in pixels: the cheapest around its points, the largest block first.

    Args:
        places: (P, 2). groups: indices of points. cells: width and height of a number of each group. frame: [left, low,
            right, high] around all blocks. segments: (S, 4), lines to avoid.
    """
    markers = np.concatenate([places - _MARKER_PX, places + _MARKER_PX], axis=1)
    points = [places[list(group)].mean(axis=0) for group in groups]
    sizes = [cell * _shape(len(group)) for cell, group in zip(cells, groups, strict=True)]
    tried = [_around(point, size, frame) for point, size in zip(points, sizes, strict=True)]
    ways = [_ways(boxes, point) for boxes, point in zip(tried, points, strict=True)]
    fixed = [
        np.hypot(*(way[:, 2:] - way[:, :2]).T)
        + _ON_A_POINT * _overlap(boxes, markers).sum(axis=1)
        + _ON_A_LINE * _cross(boxes, segments).sum(axis=1)
        + _WAY_OVER_A_POINT * _cross(np.delete(markers, list(group), axis=0), way).sum(axis=0)
        for boxes, way, group in zip(tried, ways, groups, strict=True)
    ]
    chosen: dict[int, Block] = {}
    for _ in range(_SWEEPS):
        before = dict(chosen)
        for k in sorted(range(len(groups)), key=lambda k: (-len(groups[k]), k)):
            others = [block for j, block in chosen.items() if j != k]
            best = int(np.argmin(fixed[k] + _beside(tried[k], ways[k], others)))
            chosen[k] = Block(tried[k][best], ways[k][best])
        if all(k in before and (before[k].box == chosen[k].box).all() for k in chosen):
            break
    return [chosen[k] for k in range(len(groups))]


def _beside(boxes: Floats, ways: Floats, others: Sequence[Block]) -> Floats | float:
    """Cost of each place, given the other blocks."""
    if not others:
        return 0.0
    theirs = np.array([other.box for other in others])
    their_ways = np.array([other.way for other in others if other.is_far]).reshape(-1, 4)
    return (
        _ON_A_BLOCK * _overlap(boxes, theirs).sum(axis=1)
        + _WAY_OVER_A_BLOCK * (_cross(theirs, ways).sum(axis=0) + _cross(boxes, their_ways).sum(axis=1))
        + _WAY_OVER_A_WAY * _meet(ways, their_ways).sum(axis=1)
    )


def _cell_px(digits: int) -> Floats:
    """Width and height of a number with its gap, px."""
    return np.array([_DIGIT_PX * digits + _GAP_PX, _LINE_PX])


def _shape(count: int) -> tuple[int, int]:
    """Columns and rows of a block of so many numbers."""
    return min(count, _COLUMNS), math.ceil(count / _COLUMNS)


def _middles(box: Floats, cell: Floats, count: int) -> Floats:
    """Middles of the numbers of a block, (count, 2) px, row after row from above."""
    row, column = np.divmod(np.arange(count), _COLUMNS)
    return np.stack([box[0] + (column + 0.5) * cell[0], box[3] - (row + 0.5) * cell[1]], axis=1)


def _around(point: Floats, size: Floats, frame: Floats) -> Floats:
    """Boxes (B, 4) around a point within the frame, near ones first; if there is none, one beside the point."""
    gap = _MARKER_PX + _RING_PX * np.arange(_RINGS)[:, None, None]
    angle = 2.0 * math.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    towards = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # on a rectangle, so that a block above or below is centred as near as one at the side
    towards /= np.abs(towards).max(axis=1, keepdims=True)
    middle = (point + towards * (gap + size / 2)).reshape(-1, 2)
    boxes = np.concatenate([middle - size / 2, middle + size / 2], axis=1)
    inside = (boxes[:, :2] >= frame[:2]).all(axis=1) & (boxes[:, 2:] <= frame[2:]).all(axis=1)
    return boxes[inside] if inside.any() else boxes[:1]


def _ways(boxes: Floats, point: Floats) -> Floats:
    """Lines (B, 4) from the point to the nearest place of each box."""
    nearest = np.clip(point, boxes[:, :2], boxes[:, 2:])
    return np.concatenate([np.broadcast_to(point, nearest.shape), nearest], axis=1)


def _overlap(boxes: Floats, others: Floats) -> NDArray[np.bool_]:
    """Mask (B, O) of boxes that overlap."""
    one, other = boxes[:, None], others[None]
    found: NDArray[np.bool_] = np.all((one[..., :2] < other[..., 2:]) & (other[..., :2] < one[..., 2:]), axis=-1)
    return found


def _cross(boxes: Floats, segments: Floats) -> NDArray[np.bool_]:
    """Mask (B, S) of segments that cross a box, by clipping at its slabs, axis by axis."""
    start, way = segments[None, :, :2], segments[None, :, 2:] - segments[None, :, :2]
    way = np.where(way == 0.0, 1e-9, way)
    low, high = (boxes[:, None, :2] - start) / way, (boxes[:, None, 2:] - start) / way
    first = np.minimum(low, high).max(axis=-1)
    last = np.maximum(low, high).min(axis=-1)
    found: NDArray[np.bool_] = (first < last) & (last > 1e-6) & (first < 1.0 - 1e-6)
    return found


def _meet(segments: Floats, others: Floats) -> NDArray[np.bool_]:
    """Mask (S, O) of segments that cross: the ends of each lie on both sides of the other."""
    a, b = segments[:, None, :2], segments[:, None, 2:]
    c, d = others[None, :, :2], others[None, :, 2:]
    return (_turn(a, b, c) * _turn(a, b, d) < 0.0) & (_turn(c, d, a) * _turn(c, d, b) < 0.0)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the area of the triangle, positive where a → b → c turns left."""
    area: Floats = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    return area
