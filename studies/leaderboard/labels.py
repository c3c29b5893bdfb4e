"""Placement of names next to the points of a plot, so that they overlap as little as possible."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_SIZE, _LARGE = 6.8, 8.5  # points
_POINT_PX = 6.0  # half the side of a point's square
_GAP_PX = 3.0  # between a point and its name
_LEADER_PX = 14.0  # a name farther from its point than this has a line to it
# Places that are tried around a point
_RING_PX = 6.0
_RINGS = 26
_DIRECTIONS = 24
# Cost of a place, added to its distance in pixels
_ON_A_NAME = 3000.0
_ON_A_POINT = 700.0
_ON_A_LINE = 120.0
_LEADER_OVER_A_NAME = 400.0
_LEADER_OVER_A_LEADER = 150.0
_LEADER_OVER_A_POINT = 90.0
_NEARER_TO_ANOTHER = 60.0
_LONG_PX = 60.0  # a line of this length costs twice its length
_SWEEPS = 6  # rounds in which each name is moved while the others stay
_ORDERS = ((0.0, -1.0), (0.0, 1.0), (1.0, 0.0), (-1.0, 0.0))  # initial directions; the best result is used


class Named(NamedTuple):
    """A point and its name; large: emphasised."""

    name: str
    x: float
    y: float
    tone: str
    large: bool = False


class Placed(NamedTuple):
    """A placed name: its box [left, low, right, high], (4,) px, and its point, (2,) px."""

    box: Floats
    point: Floats

    @property
    def leader(self) -> Floats:
        """Line from the point to the nearest point of the box, [x, y, x, y], px."""
        return np.concatenate([self.point, np.clip(self.point, self.box[:2], self.box[2:])])

    @property
    def is_far(self) -> bool:
        """Returns whether the name needs a line to its point."""
        return math.dist(self.leader[:2], self.leader[2:]) > _LEADER_PX


def label(ax: Axes, named: Sequence[Named], lines: Sequence[Floats] = ()) -> None:
    """Write the names into a plot whose limits, size and layout are final.

    Args:
        lines: polylines (K, 2) to avoid, in the plot's coordinates.
    """
    figure = ax.get_figure(root=True)
    assert figure is not None
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    texts = [_text(ax, one) for one in named]
    sizes = [text.get_window_extent(renderer) for text in texts]
    points = ax.transData.transform([(one.x, one.y) for one in named]).reshape(-1, 2)
    legend = ax.get_legend()
    kept_free = [np.array(legend.get_window_extent(renderer).extents)] if legend is not None else []
    frame = np.array(ax.get_window_extent(renderer).extents)
    placed = place(points, [(size.width, size.height) for size in sizes], frame, _segments(ax, lines), kept_free)
    to_axes = ax.transAxes.inverted().transform
    for one, text, where in zip(named, texts, placed, strict=True):
        left, middle = to_axes((where.box[0], (where.box[1] + where.box[3]) / 2))
        text.set_position((left, middle))
        if where.is_far:
            (x0, y0), (x1, y1) = to_axes(where.leader.reshape(2, 2))
            way = Line2D([x0, x1], [y0, y1], transform=ax.transAxes, color=one.tone, linewidth=0.6, alpha=0.8)
            way.set_zorder(4)
            ax.add_line(way).set_in_layout(False)


def place(
    points: Floats,
    sizes: Sequence[tuple[float, float]],
    frame: Floats,
    segments: Floats,
    kept_free: Sequence[Floats] = (),
) -> list[Placed]:
    """Places of the names of `points` (P, 2), with texts of `sizes` (width and height); all in pixels.

    Each name in turn takes the cheapest place around its point, until nothing changes. Of several orders the cheapest
    result is used.

    Args:
        frame: [left, low, right, high] around all names. segments: (S, 4), lines to avoid. kept_free: boxes to avoid.
    """
    squares = np.concatenate([points - _POINT_PX, points + _POINT_PX], axis=1)
    tried = [_around(point, *size, frame) for point, size in zip(points, sizes, strict=True)]
    fixed = [
        _lengths(boxes, point)
        + _ON_A_POINT * _overlaps(boxes, np.delete(squares, k, axis=0)).sum(axis=1)
        + _ON_A_NAME * _overlaps(boxes, np.array(kept_free).reshape(-1, 4)).sum(axis=1)
        + _ON_A_LINE * _crosses(boxes, segments).sum(axis=1)
        + _LEADER_OVER_A_POINT * _crosses(squares, _leaders(boxes, point)).sum(axis=0)
        + _NEARER_TO_ANOTHER * _is_nearer_to_another(boxes, points, k)
        for k, (boxes, point) in enumerate(zip(tried, points, strict=True))
    ]
    found = [_settled(points, tried, fixed, np.argsort(points @ np.array(order), kind="stable")) for order in _ORDERS]
    chosen, _ = min(found, key=lambda one: one[1])
    return [Placed(tried[k][chosen[k]], points[k]) for k in range(len(points))]


def _settled(
    points: Floats, tried: Sequence[Floats], fixed: Sequence[Floats], order: Iterable[int]
) -> tuple[dict[int, int], float]:
    """Index in `tried` of the place of every name, and the total cost, for one order."""
    chosen: dict[int, int] = {}
    cost = 0.0
    for _ in range(_SWEEPS):
        before, cost = dict(chosen), 0.0
        for k in order:
            others = [Placed(tried[j][at], points[j]) for j, at in chosen.items() if j != k]
            costs = fixed[k] + _beside(tried[k], points[k], others)
            chosen[k] = int(np.argmin(costs))
            cost += float(costs[chosen[k]])
        if chosen == before:
            break
    return chosen, cost


def _beside(boxes: Floats, point: Floats, others: Sequence[Placed]) -> Floats | float:
    """Cost of each place, given the placed names."""
    if not others:
        return 0.0
    leaders = _leaders(boxes, point)
    theirs = np.array([other.box for other in others])
    ways = np.array([other.leader for other in others if other.is_far]).reshape(-1, 4)
    return (
        _ON_A_NAME * _overlaps(boxes, theirs).sum(axis=1)
        + _LEADER_OVER_A_NAME * _crosses(theirs, leaders).sum(axis=0)
        + _LEADER_OVER_A_NAME * _crosses(boxes, ways).sum(axis=1)
        + _LEADER_OVER_A_LEADER * _meet(leaders, ways).sum(axis=1)
    )


def _text(ax: Axes, one: Named) -> Text:
    size, weight = (_LARGE, "bold") if one.large else (_SIZE, "normal")
    text = ax.text(0.5, 0.5, one.name, transform=ax.transAxes, color=one.tone, fontsize=size, fontweight=weight)
    text.set(ha="left", va="center", zorder=6, in_layout=False)
    text.set_path_effects([withStroke(linewidth=1.4, foreground="white")])
    return text


def _segments(ax: Axes, lines: Sequence[Floats]) -> Floats:
    pieces = [ax.transData.transform(line) for line in lines if len(line) > 1]
    return np.concatenate([np.concatenate([p[:-1], p[1:]], axis=1) for p in pieces] or [np.empty((0, 4))])


def _around(point: Floats, width: float, height: float, frame: Floats) -> Floats:
    """Boxes (B, 4) around a point within the frame, near ones first; if there is none, one on the point."""
    boxes = np.array(list(_rings(point, width, height)))
    inside = (boxes[:, :2] >= frame[:2]).all(axis=1) & (boxes[:, 2:] <= frame[2:]).all(axis=1)
    return boxes[inside] if inside.any() else boxes[:1]


def _rings(point: Floats, width: float, height: float) -> Iterator[tuple[float, float, float, float]]:
    x, y = point
    for ring in range(_RINGS):
        gap = _POINT_PX + _GAP_PX + _RING_PX * ring
        for turn in range(_DIRECTIONS):
            angle = 2.0 * math.pi * turn / _DIRECTIONS
            left, low = x + math.cos(angle) * (gap + width / 2), y + math.sin(angle) * (gap + height / 2)
            yield left - width / 2, low - height / 2, left + width / 2, low + height / 2


def _leaders(boxes: Floats, point: Floats) -> Floats:
    """Lines (B, 4) from the point to each box; zero length if the box is near."""
    ends = np.clip(point, boxes[:, :2], boxes[:, 2:])
    near = np.hypot(*(ends - point).T) <= _LEADER_PX
    return np.concatenate([np.broadcast_to(np.where(near[:, None], ends, point), ends.shape), ends], axis=1)


def _lengths(boxes: Floats, point: Floats) -> Floats:
    """Cost of the distance of each box from the point."""
    gaps = np.clip(point, boxes[:, :2], boxes[:, 2:]) - point
    far = np.hypot(gaps[:, 0], gaps[:, 1])
    cost: Floats = far * (1.0 + far / _LONG_PX)
    return cost


def _is_nearer_to_another(boxes: Floats, points: Floats, own: int) -> NDArray[np.bool_]:
    """Mask (B,) of boxes that are nearer to another point."""
    gaps = np.clip(points[None], boxes[:, None, :2], boxes[:, None, 2:]) - points[None]  # (B, P, 2)
    far = np.hypot(gaps[..., 0], gaps[..., 1])
    found: NDArray[np.bool_] = far.min(axis=1) < far[:, own] - _GAP_PX
    return found


def _overlaps(boxes: Floats, others: Floats) -> NDArray[np.bool_]:
    """Mask (B, O) of boxes that overlap."""
    one, other = boxes[:, None], others[None]
    found: NDArray[np.bool_] = np.all(one[..., :2] < other[..., 2:], axis=-1) & np.all(
        other[..., :2] < one[..., 2:], axis=-1
    )
    return found


def _crosses(boxes: Floats, segments: Floats) -> NDArray[np.bool_]:
    """Mask (B, S) of segments that cross a box, by clipping at its slabs, axis by axis."""
    start, way = segments[None, :, :2], segments[None, :, 2:] - segments[None, :, :2]
    way = np.where(way == 0.0, 1e-9, way)
    low, high = (boxes[:, None, :2] - start) / way, (boxes[:, None, 2:] - start) / way
    first = np.minimum(low, high).max(axis=-1)
    last = np.maximum(low, high).min(axis=-1)
    found: NDArray[np.bool_] = (
        (first < last) & (last > 0.0) & (first < 1.0) & (np.hypot(*np.moveaxis(way, -1, 0)) > 1e-6)
    )
    return found


def _meet(segments: Floats, others: Floats) -> NDArray[np.bool_]:
    """Mask (S, O) of segments that cross: the ends of each lie on both sides of the other."""
    a = segments[:, None, :2]
    b = segments[:, None, 2:]
    c = others[None, :, :2]
    d = others[None, :, 2:]
    return (_turn(a, b, c) * _turn(a, b, d) < 0.0) & (_turn(c, d, a) * _turn(c, d, b) < 0.0)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the area of the triangle, positive where a → b → c turns left."""
    area: Floats = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    return area
