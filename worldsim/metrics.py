"""How well the swarm flies as a flock: alignment, risk, collisions. Over all pairs, exact.

In a large swarm, who is near whom is looked for among those who are side by side along x, or, without the compiled
kernel, asked of a k-d tree. Alignment is a sum of N²/2 square roots, for which no exact short cut is known: it is taken
row by row, compiled in less than 1 ns a pair. The memory of both grows with N and the pairs found, not with N².
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from swarm import state
from swarm.scenario import Metrics
from worldsim import kernel

Floats = NDArray[np.float64]

FEW = 100  # up to here all pairs as one array are cheaper than a tree; measured


@dataclass(frozen=True, slots=True)
class Pairs:
    """One instant of a swarm of N, leading axes free.

    speed_difference: mean over all N² pairs of ‖v_j − v_i‖, m/s (the integrand of φ_A).
    near: pairs i < j within the hazard radius.
    colliding: (K, axes + 2), ascending: the leading indices, i and j of the K pairs i < j within the collision radius.
    """

    speed_difference: Floats
    near: NDArray[np.intp]
    colliding: NDArray[np.intp]


def pairs(metrics: Metrics, states: state.States) -> Pairs:
    """Measures all pairs of `states`, `(..., N, 4)`; an instant's numbers do not depend on the others'."""
    return few(metrics, states) if states.shape[-2] <= FEW else many(metrics, states)


def few(metrics: Metrics, states: state.States) -> Pairs:
    """All pairs of all instants as one array: each once, the instants side by side."""
    n, leading = states.shape[-2], states.shape[:-2]
    first, second, place = _all_pairs(n)
    columns = np.ascontiguousarray(states.reshape(-1, n, state.SIZE).transpose(2, 1, 0))
    difference = columns.take(first, axis=1, mode="clip")  # "clip": straight into the result, without a second check
    difference -= columns.take(second, axis=1, mode="clip")
    difference *= difference
    position, velocity = difference.reshape(2, state.AXES, len(first), columns.shape[-1])
    distance = np.add(position[0], position[1], out=position[0])
    speeds = np.zeros((len(first) + 1, distance.shape[1]))  # and that of a UAV to itself
    np.sqrt(np.add(velocity[0], velocity[1], out=velocity[0]), out=speeds[:-1])
    matrix = np.ascontiguousarray(speeds.T).take(place, axis=1, mode="clip")  # all N², in whose order they are summed
    total = np.add.reduce(matrix, axis=-1)
    near = np.add.reduce(distance <= metrics.hazard_radius**2, axis=0, dtype=np.intp)
    touching = distance < metrics.collision_radius**2
    colliding = _nobody(states)
    if np.count_nonzero(touching):
        instant, pair = np.nonzero(touching.T)
        where = np.unravel_index(instant, leading) if leading else ()
        colliding = np.stack([*where, first[pair], second[pair]], axis=-1)
    return Pairs((total / n**2).reshape(leading)[()], near.reshape(leading)[()], colliding)


@lru_cache(maxsize=8)
def _all_pairs(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """i and j of the pairs i < j, ascending, and by rows of the N × N matrix which pair an entry is; the last + 1 where
    it is none."""
    first, second = np.triu_indices(n, 1)
    place = np.full((n, n), len(first))
    place[first, second] = place[second, first] = np.arange(len(first))
    return first, second, place.ravel()


def many(metrics: Metrics, states: state.States) -> Pairs:
    """The same instant by instant, without an N × N array."""
    leading = states.shape[:-2]
    speed_difference, near = np.empty(leading), np.empty(leading, dtype=np.intp)
    colliding = [_nobody(states)]
    for index in np.ndindex(leading):
        instant = states[index]
        speed_difference[index] = _mean_distance(instant[:, state.VELOCITY])
        near[index], touching = _near(metrics, instant[:, state.POSITION])
        if len(touching):
            found = np.empty((len(touching), len(leading) + 2), dtype=np.intp)
            found[:, :-2], found[:, -2:] = index, touching[np.lexsort((touching[:, 1], touching[:, 0]))]
            colliding.append(found)
    return Pairs(speed_difference[()], near[()], np.concatenate(colliding))


def _nobody(states: state.States) -> NDArray[np.intp]:
    return np.empty((0, states.ndim), dtype=np.intp)


def _mean_distance(points: Floats) -> float:
    """Mean over all N² pairs of points."""
    columns = np.ascontiguousarray(points.T)
    total = kernel.distances(columns)
    return 2.0 * (distances(columns) if total is None else total) / len(points) ** 2


def distances(columns: Floats) -> float:
    """The sum over the pairs i < j of points, given as columns (2, N): each row added up, and then the rows."""
    n = columns.shape[1]
    rows = np.zeros(max(1, n - 1))
    for i in range(n - 1):
        difference = columns[:, i + 1 :] - columns[:, i, None]
        difference *= difference
        rows[i] = np.add.reduce(np.sqrt(difference[0] + difference[1]))
    return float(np.add.reduce(rows))


def _near(metrics: Metrics, points: Floats) -> tuple[int, NDArray[np.intp]]:
    """How many pairs are within the hazard radius, and those within the collision radius, (K, 2), i < j."""
    most, least = metrics.hazard_radius**2, metrics.collision_radius**2
    reach = max(metrics.hazard_radius, metrics.collision_radius) * (1.0 + 1e-9)
    order = points[:, 0].argsort(kind="stable")
    found = kernel.near(points.T.take(order, axis=1), reach, most, least)
    if found is not None:
        near, touching = found
        return near, np.sort(order[touching], axis=-1)
    pairs, squared = _within(points, reach)
    return int((squared <= most).sum()), pairs[squared < least]


def _within(points: Floats, reach: float) -> tuple[NDArray[np.intp], Floats]:
    """At least all pairs i < j within so many metres, (K, 2), and their squared distances, rounded as in `few`."""
    from scipy.spatial import cKDTree  # a tenth of a second that nobody else need wait

    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # built anew each tick: its build counts, too
    found: NDArray[np.intp] = tree.query_pairs(reach, output_type="ndarray")
    difference = points[found[:, 0]] - points[found[:, 1]]
    difference *= difference
    return found, difference[:, 0] + difference[:, 1]
