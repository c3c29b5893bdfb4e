"""How well the swarm flies as a flock: alignment, risk, collisions. Over all pairs, exact.

In a large swarm, who is near whom is asked of a k-d tree: N log N, and the pairs found. Alignment is a sum of N²/2
square roots, for which no exact short cut is known: it is taken block by block, 1 to 2 ns a pair, in memory that does
not grow with N².
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swarm import state
from swarm.scenario import Metrics

Floats = NDArray[np.float64]

FEW = 100  # up to here all pairs as one array are cheaper than a tree; measured
_BLOCK = 2**17  # distances at a time: 1 MiB


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
    """All N² pairs of all instants as one array."""
    n = states.shape[-2]
    x, y, vx, vy = (states[..., k] for k in (state.X, state.Y, state.VX, state.VY))

    def squared(first: Floats, second: Floats) -> Floats:
        along = first[..., :, None] - first[..., None, :]
        across = second[..., :, None] - second[..., None, :]
        along *= along
        across *= across
        along += across
        return along

    distance = squared(x, y)
    speeds = np.sqrt(squared(vx, vy))
    near = (distance <= metrics.hazard_radius**2).sum(axis=(-2, -1))
    colliding = distance < metrics.collision_radius**2
    total = speeds.reshape(*speeds.shape[:-2], n * n).sum(axis=-1)
    if np.count_nonzero(colliding) == colliding.size // n:  # each with itself
        return Pairs(total / n**2, (near - n) // 2, _nobody(states))
    found = np.argwhere(colliding)
    return Pairs(total / n**2, (near - n) // 2, found[found[:, -2] < found[:, -1]])


def many(metrics: Metrics, states: state.States) -> Pairs:
    """The same instant by instant, without an N × N array."""
    leading = states.shape[:-2]
    speed_difference, near = np.empty(leading), np.empty(leading, dtype=np.intp)
    colliding = [_nobody(states)]
    for index in np.ndindex(leading):
        instant = states[index]
        speed_difference[index] = _mean_distance(instant[:, state.VELOCITY])
        first, second, squared = _within(
            instant[:, state.POSITION], max(metrics.hazard_radius, metrics.collision_radius)
        )
        near[index] = (squared <= metrics.hazard_radius**2).sum()
        touching = np.flatnonzero(squared < metrics.collision_radius**2)
        if len(touching):
            found = np.empty((len(touching), len(leading) + 2), dtype=np.intp)
            found[:, :-2], found[:, -2], found[:, -1] = index, first[touching], second[touching]
            colliding.append(found[np.lexsort((found[:, -1], found[:, -2]))])
    return Pairs(speed_difference[()], near[()], np.concatenate(colliding))


def _nobody(states: state.States) -> NDArray[np.intp]:
    return np.empty((0, states.ndim), dtype=np.intp)


def _mean_distance(points: Floats) -> float:
    """Mean over all N² pairs of points."""
    from scipy.spatial.distance import cdist, pdist  # a tenth of a second that a small swarm need not wait

    n, total = len(points), 0.0
    rows = max(1, _BLOCK // n)
    for start in range(0, n, rows):
        block, rest = points[start : start + rows], points[start + rows :]
        total += float(pdist(block).sum())
        if len(rest):
            total += float(cdist(block, rest).sum())
    return 2.0 * total / n**2


def _within(points: Floats, radius: float) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """At least all pairs i < j within a radius: i, j and the squared distances, rounded as in `few`."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # built anew each tick: its build counts, too
    found = tree.query_pairs(radius * (1.0 + 1e-9), output_type="ndarray")
    first, second = found[:, 0], found[:, 1]
    difference = points[first] - points[second]
    difference *= difference
    return first, second, difference[:, 0] + difference[:, 1]
