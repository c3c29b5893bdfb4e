"""UAVs and obstacles near a UAV, as pairs (`near`, `edges`) or in a fixed number of columns (`closest`)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.kernels.ranking import move_apart
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, Rows, States, Vectors

NOWHERE_M = 1e-9  # a distance without a direction
OBSTACLE = 10.0  # weight of an obstacle relative to a UAV if not all half-planes can be satisfied


class Near(NamedTuple):
    """P pairs of a row and another UAV, sorted by row, then by number.

    row, other: (P,). apart: (P, d) own position minus the other's, m. closing: (P, d) own velocity minus the other's,
    m/s. distance: (P,) m. away: (P, d) unit vector away from the other; if both are at one place, it is along x, and
    the higher number is on the right.
    """

    row: NDArray[np.intp]
    other: NDArray[np.intp]
    apart: Vectors
    closing: Vectors
    distance: Rows
    away: Vectors


def near(
    own: States,
    states: States,
    uavs: NDArray[np.integer],
    range_m: float,
    matters: Callable[[Floats, Floats], NDArray[np.bool_]] | None = None,
) -> Near:
    """The pairs at most `range_m` apart that satisfy `matters`.

    Args:
        own: (M, 2d). states: (M, N, 2d), states of all UAVs known to each row. uavs: (M,), the numbers of the rows.
        matters: condition on squared distances and squared differences of velocity, (M, N) each, m² and m²/s².
    """
    axes = state.axes(own)
    gaps = _gaps(own, states, range(axes))
    squared = state.squared(gaps)
    squared[np.arange(len(own)), uavs] = np.inf
    chosen = squared <= range_m * range_m
    if matters is not None:
        chosen &= matters(squared, state.squared(_gaps(own, states, range(axes, 2 * axes))))
    row, other = np.nonzero(chosen)
    apart = np.stack([gap[row, other] for gap in gaps], axis=-1)
    closing = state.velocity(own).take(row, axis=0) - states[row, other, axes:]
    distance = np.sqrt(squared[row, other])
    away = apart / np.maximum(distance, NOWHERE_M)[:, None]
    if (one_place := distance < NOWHERE_M).any():
        away[one_place] = 0.0
        away[one_place, 0] = np.where(uavs[row] > other, 1.0, -1.0)[one_place]
    return Near(row, other, apart, closing, distance, away)


def _gaps(own: Floats, others: Floats, columns: range) -> list[Floats]:
    """Differences of rows (M, …) and others (M, N, …), or (N, …) that are those of all rows; (M, N) in each column."""
    return [own[:, column, None] - others[..., column] for column in columns]


def level(axes: int, x: Rows, y: Rows) -> Vectors:
    """Level vectors (…, axes) with these numbers along x and y, (…) each."""
    return np.stack([x, y] if axes == state.PLANE else [x, y, np.zeros(x.shape)], axis=-1)


class Edges(NamedTuple):
    """The edges of all K obstacles as M rows see them.

    distance: (M, K) m, negative inside. away: unit vectors away from the obstacles, (M, K) along each axis. closing:
    velocities relative to the nearest points of their axes, (M, 1) or (M, K) m/s along each axis.
    """

    distance: Rows
    away: list[Rows]
    closing: list[Rows]


class Obstacles:
    """The K obstacles of a scenario as UAVs see them: discs, columns and spheres, then polygons.

    A polygon looks like a column of the radius `Polygon.depth` that touches its edge in the nearest point, from inside.

    Attributes:
        radii: (K,), m.
    """

    def __init__(self, scenario: Scenario) -> None:
        polygons = mission.polygons(scenario)
        solids = mission.solids(scenario)
        self._round = np.delete(solids, list(polygons), axis=0)
        self._polygons = list(polygons.values())
        self.radii = np.append(self._round[:, 2], [polygon.depth for polygon in self._polygons])

    def __len__(self) -> int:
        return len(self.radii)

    def seen(self, own: States) -> tuple[list[Rows], list[Rows]]:
        """Places of rows (M, 2d) relative to the nearest points of the axes, (M, K) m for each number, and their
        velocities, (M, 1) or (M, K) m/s for each. Axes of columns move along upward, and those of flat sides along
        these.
        """
        gaps, closing = _from_axes(own, self._round)
        if not self._polygons:
            return gaps, closing
        velocity, beside = state.flat(state.velocity(own)), []
        for polygon in self._polygons:
            found = polygon.nearest(state.flat(own))
            normal = state.inner(velocity, found.outward)[:, None] * found.outward
            moving = np.where(found.slides[:, None], normal, velocity)
            beside.append([*((found.distance + polygon.depth)[:, None] * found.outward).T, *moving.T])
        x, y, *speeds = np.moveaxis(np.array(beside), 0, -1)
        more = [x, y]
        if state.axes(own) == state.SPACE:
            tops = np.array([polygon.highest for polygon in self._polygons])
            height, upward = _above(own, np.full(len(tops), -np.inf), tops)
            more, speeds = [*more, height], [*speeds, upward]
        closing = [np.broadcast_to(along, gaps[0].shape) for along in closing]
        return _joined(gaps, more), _joined(closing, speeds)


def _joined(parts: list[Rows], more: list[Rows]) -> list[Rows]:
    return [np.concatenate(both, axis=1) for both in zip(parts, more, strict=True)]


def edges(own: States, obstacles: Obstacles) -> Edges:
    """The edges of all obstacles; the top of a column counts as a dome of its radius."""
    gaps, closing = obstacles.seen(own)
    distance = np.sqrt(state.squared(gaps))
    length = np.maximum(distance, NOWHERE_M)
    return Edges(distance - obstacles.radii, [gap / length for gap in gaps], closing)


def _from_axes(own: States, solids: Floats) -> tuple[list[Rows], list[Rows]]:
    """Places of rows (M, 2d) relative to the nearest points of the axes of K solids, (M, K) m for each number; and
    velocities relative to these points, which move along with a UAV beside a column, (M, 1) or (M, K) m/s for each.
    """
    gaps = _gaps(own, solids, range(2))
    closing = [along[:, None] for along in state.parts(state.flat(state.velocity(own)))]
    if state.axes(own) == state.PLANE:
        return gaps, closing
    height, upward = _above(own, *solids[:, 3:].T)
    return [*gaps, height], [*closing, upward]


def _above(own: States, lowest: Rows, highest: Rows) -> tuple[Rows, Rows]:
    """Heights of rows (M, 6) above upright axes from `lowest` to `highest` (K,), and speeds upward, (M, K) each."""
    z, v_z = own[:, 2, None], own[:, 5, None]
    return z - np.clip(z, lowest, highest), np.where((z <= lowest) | (z >= highest), v_z, 0.0)


def summed(row: NDArray[np.intp], vectors: Vectors, rows: int) -> Vectors:
    """Sums of vectors (P, d) by row, (rows, d), in the order of the vectors."""
    return np.stack([np.bincount(row, vectors[:, axis], rows) for axis in range(vectors.shape[1])], axis=-1)


class Closest(NamedTuple):
    """The K closest objects (UAVs or obstacles) of each of M rows, the closest first.

    away: (M, K, d) m, from the object to the row's UAV. closing: (M, K, d) m/s, velocity of the UAV minus that of the
    object. squared: (M, K) m², of `away`. present: (M, K), mask of the columns in use; other columns have no meaning.
    """

    away: Vectors
    closing: Vectors
    squared: Rows
    present: Mask


def closest(own: States, others: States, uavs: NDArray[np.integer], reach_m: float, most: int) -> Closest:
    """The other UAVs within reach, at most so many, ties by number.

    Args:
        own: (M, 2d), states of the rows, which are `uavs` (M,). others: (M, N, 2d), states of all UAVs known to them.
    """
    shape = len(own), most
    away, closing = np.empty((*shape, state.axes(own))), np.empty((*shape, state.axes(own)))
    squared, found = np.empty(shape), np.empty(shape, dtype=np.intp)
    count = kernels.neighbours(
        np.ascontiguousarray(own),
        np.ascontiguousarray(np.swapaxes(others, 1, 2)),
        uavs.astype(np.intp, copy=False),
        reach_m * reach_m,
        away,
        closing,
        squared,
        found,
    )
    return Closest(away[:, :count], closing[:, :count], squared[:, :count], found[:, :count] >= 0)


def closest_obstacles(own: States, obstacles: Obstacles, reach_m: float, most: int) -> tuple[Closest, Rows]:
    """The obstacles whose edge is within reach, at most so many; and their radii, (M, K) m.

    The nearest point of the axis of a column moves along with a UAV beside it, so what is relative to it is level.
    The top of a column counts as a dome of its radius.
    """
    gaps, closing = obstacles.seen(own)
    which, present = _first(np.sqrt(state.squared(gaps)) - obstacles.radii, reach_m, most)
    row, shape = np.arange(len(own))[:, None], gaps[0].shape
    speeds = np.stack([np.broadcast_to(along, shape)[row, which] for along in closing], axis=-1)
    away = np.stack([gap[row, which] for gap in gaps], axis=-1)
    squared = state.squared(state.parts(away))
    move_apart(away, squared, present, left=False)
    return Closest(away, speeds, squared, present), obstacles.radii[which]


def _first(distance: Rows, reach: float, most: int) -> tuple[NDArray[np.intp], Mask]:
    """Columns within reach, at most `most`, nearest first; and the mask of those in use: (M, K)."""
    found = np.empty((len(distance), most), dtype=np.intp)
    which = found[:, : kernels.closest(distance, reach, found)]
    return which, which >= 0


def stopping_speed(distance_m: Rows, deceleration: float, delay_s: float) -> Rows:
    """Speeds from which a UAV can stop within distances (…,) if braking begins after a delay, m/s.

    Solution v of v · delay + v² / (2 · deceleration) = distance. For a negative distance it is distance / delay, so
    that the UAV leaves a forbidden region within one delay.
    """
    lag = deceleration * delay_s
    outside = np.sqrt(lag * lag + 2.0 * deceleration * np.maximum(distance_m, 0.0)) - lag
    return np.where(distance_m > 0.0, outside, distance_m / delay_s)


def stopping_slope(distance_m: Rows, deceleration: float, delay_s: float) -> Rows:
    """Derivatives of `stopping_speed` by the distance, (…,) 1/s; 1 / delay at 0 and below."""
    lag = deceleration * delay_s
    if lag == 0.0:  # no deceleration: the speed is 0 at every distance
        return np.where(distance_m > 0.0, 0.0, 1.0 / delay_s)
    return deceleration / np.sqrt(lag * lag + 2.0 * deceleration * np.maximum(distance_m, 0.0))


def to_the_right(velocity: Vectors, bias: float) -> Vectors:
    """Velocities (M, d) plus a share of each, turned by 90° to the right about the vertical, m/s."""
    return velocity + bias * level(velocity.shape[1], velocity[:, 1], -velocity[:, 0])


def with_obstacles(normals: Vectors, bounds: Rows, more: Vectors, least: Rows) -> tuple[Vectors, Rows]:
    """Append the half-planes of obstacles, `more` and `least`, with weight `OBSTACLE`, to those of UAVs, normals
    (M, K, d) and bounds (M, K)."""
    return np.concatenate([normals, OBSTACLE * more], axis=1), np.concatenate([bounds, OBSTACLE * least], axis=1)
