"""Polygons seen from above: distances, ways that enter them, and what is no polygon. Rows are independent."""

from typing import NamedTuple, Self

import numpy as np

from meanflock.swarm.state import PLANE, Floats, Mask, Rows, Vectors, flat

_NOWHERE_M = 1e-9  # a distance without a direction


class Nearest(NamedTuple):
    """The point of a polygon's edge that is nearest to each place (…).

    distance: (…) m, negative inside. outward: (…, 2), unit vectors out of the polygon. slides: (…), whether the point
    moves along a side with the place, and is no corner.
    """

    distance: Rows
    outward: Vectors
    slides: Mask


class Polygon:
    """A prism without a bottom, up to `highest`, m.

    Attributes:
        corners: (V, 2), m, counter-clockwise.
        highest: its top; infinite without an end.
        depth: no place inside is farther from the edge, m.
        disc: x, y and radius of a disc around it, m.
    """

    def __init__(self, corners: Floats, highest: float) -> None:
        """`corners`: as given, without a `problem`."""
        self.corners = corners if _area(corners) > 0.0 else corners[::-1]
        self.highest = highest
        self._ends = np.roll(self.corners, -1, axis=0)  # of the sides
        self._sides = self._ends - self.corners
        self._squared = (self._sides**2).sum(axis=1)
        low, high = corners.min(axis=0), corners.max(axis=0)
        self.depth = float((high - low).min()) / 2.0
        centre = (low + high) / 2.0
        self.disc = (*centre.tolist(), float(np.hypot(*(corners - centre).T).max()))

    @classmethod
    def of(cls, corners: tuple[tuple[float, float], ...], height: float | None) -> Self:
        """The polygon of an obstacle."""
        return cls(np.array(corners, dtype=np.float64), np.inf if height is None else height)

    @property
    def ring(self) -> Floats:
        """The closed line around it, (V + 1, 2), m."""
        return np.concatenate([self.corners, self.corners[:1]])

    def nearest(self, places: Vectors) -> Nearest:
        """The nearest points of the edge to places (…, 2), m."""
        x, y = (places[..., axis, None] - self.corners[:, axis] for axis in range(2))
        along, across = self._sides.T
        share = (x * along + y * across) / self._squared
        share = np.clip(share, 0.0, 1.0)
        away_x, away_y = x - share * along, y - share * across
        distances = np.sqrt(away_x * away_x + away_y * away_y)
        side = distances.argmin(axis=-1)

        def of_side(values: Floats) -> Floats:
            return np.take_along_axis(values, side[..., None], axis=-1)[..., 0]

        distance, at = of_side(distances), of_side(share)
        sign = np.where(self.contains(places), -1.0, 1.0)
        length = np.sqrt(self._squared[side])
        normal = np.stack([across[side] / length, -along[side] / length], axis=-1)
        scale = (sign / np.maximum(distance, _NOWHERE_M))[..., None]
        outward = np.stack([of_side(away_x), of_side(away_y)], axis=-1) * scale
        outward = np.where(distance[..., None] < _NOWHERE_M, normal, outward)
        return Nearest(sign * distance, outward, (at > 0.0) & (at < 1.0))

    def contains(self, places: Vectors) -> Mask:
        """Mask (…) of the places (…, 2) inside: a ray along x crosses an odd number of sides."""
        x, y = (places[..., axis, None] for axis in range(2))
        (x0, y0), (along, across) = self.corners.T, self._sides.T
        is_between = (y0 <= y) != (self._ends[:, 1] <= y)  # of the corners themselves: a sum of y0 and side is rounded
        crossing = x0 + np.divide(y - y0, across, out=np.zeros(is_between.shape), where=is_between) * along
        return np.count_nonzero(is_between & (x < crossing), axis=-1) % 2 == 1

    def holds(self, places: Vectors) -> Mask:
        """Mask (N,) of the places (N, d) in it, or on its edge or top."""
        within: Mask = self.nearest(flat(places)).distance <= 0.0
        return within if places.shape[-1] == PLANE else within & (places[:, 2] <= self.highest)

    def is_entered(self, first: Vectors, last: Vectors) -> Mask:
        """Mask (…) of the straight ways from `first` to `last`, (…, 2) each, that come inside; NaN comes nowhere."""
        start, end = first[..., None, :] - self.corners, last[..., None, :] - self.corners
        way = (last - first)[..., None, :]
        one = (
            _cross(self._sides, start) * _cross(self._sides, end) <= 0.0
        )  # ends on both sides of a side of the polygon
        other = _cross(way, -start) * _cross(way, self._sides - start) <= 0.0  # corners on both sides of the way
        crosses = (one & other & (_cross(self._sides, way) != 0.0)).any(axis=-1)
        return (crosses | self.contains(first) | self.contains(last)) & ~np.isnan(way).any(axis=(-2, -1))


def problem(corners: tuple[tuple[float, float], ...]) -> str | None:
    """Why corners are those of no polygon; None if they are."""
    count = len(corners)
    if count < 3:
        return f"has {count} corners; give three at least"
    for number in range(count):
        if corners[number] == corners[number - 1]:
            return f"has the corner {list(corners[number])} twice in a row; leave one out"
    points = np.array(corners, dtype=np.float64)
    sides = np.roll(points, -1, axis=0) - points
    first, second = np.triu_indices(count, 1)
    meeting = _meet(sides[first], sides[second], points[second] - points[first])
    beside = (second - first == 1) | (second - first == count - 1)  # they meet in their corner
    back = (_cross(sides[first], sides[second]) == 0.0) & (_inner(sides[first], sides[second]) < 0.0)
    if len(found := np.flatnonzero(np.where(beside, back, meeting))):
        pair = f"{first[found[0]]} and {second[found[0]]}"
        return f"crosses itself: its sides {pair} meet; list the corners in their order around it"
    return None


def _meet(one: Floats, other: Floats, start: Floats) -> Mask:
    """Whether sides have a point in common, (P,). `start`: from the begin of `one` to that of `other`, (P, 2)."""
    ends = (_cross(one, start) * _cross(one, start + other) <= 0.0) & (
        _cross(other, -start) * _cross(other, one - start) <= 0.0
    )
    low, high = np.sort([_inner(start, one), _inner(start + other, one)], axis=0)
    on_one_line = (_cross(one, start) == 0.0) & (high >= 0.0) & (low <= _inner(one, one))
    return np.where(_cross(one, other) == 0.0, on_one_line, ends)


def _inner(first: Floats, second: Floats) -> Floats:
    product: Floats = first[..., 0] * second[..., 0] + first[..., 1] * second[..., 1]
    return product


def _cross(first: Floats, second: Floats) -> Floats:
    product: Floats = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return product


def _area(corners: Floats) -> float:
    """Area within corners, m²; negative if they go clockwise."""
    return float(_cross(corners, np.roll(corners, -1, axis=0)).sum()) / 2.0
