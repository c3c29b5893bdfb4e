"""The only definition of a UAV's state: s = [r, v], its position and its velocity, metres and m/s, origin at the
destination.

A state has as many numbers of position as of velocity, one for each axis: x and y first. Arrays carry the number of
axes: states have shape `(..., 2 axes)`, vectors `(..., axes)`; leading axes of an array are free. Take parts with the
functions below, never with numbers.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]  # any shape
Mask: TypeAlias = NDArray[np.bool_]  # any shape
States: TypeAlias = NDArray[np.float64]  # (..., 2 axes)
Vectors: TypeAlias = NDArray[np.float64]  # (..., axes): accelerations, velocities, positions
Rows: TypeAlias = NDArray[np.float64]  # (...,): one number a UAV


def axes(states: States) -> int:
    """Number of axes of states: 2 in the plane."""
    return states.shape[-1] // 2


def position(states: States) -> Vectors:
    """r in m, a view. To write to some rows only, index the view: `position(states)[rows] = 0`."""
    return states[..., : states.shape[-1] // 2]


def velocity(states: States) -> Vectors:
    """v in m/s, a view. To write to some rows only, index the view: `velocity(states)[rows] = 0`."""
    return states[..., states.shape[-1] // 2 :]


def at_rest(places: Vectors) -> States:
    """States at rest at some places."""
    return np.concatenate([places, np.zeros(places.shape)], axis=-1)


def flat(vectors: Floats) -> Vectors:
    """x and y of states or vectors, `(..., 2)`, a view: for what stands on the ground, such as maps and obstacles."""
    return vectors[..., :2]


def parts(vectors: Vectors) -> list[Rows]:
    """The numbers along each axis, views `(...,)`."""
    return [vectors[..., axis] for axis in range(vectors.shape[-1])]


def squared(along: Sequence[Any] | NDArray[Any]) -> Any:
    """‖·‖² of vectors, from the numbers along each axis; arrays of any shape, or floats.

    For a view such as `velocity(states)` this is much faster than `dot`, whose innermost loop is over the axes.
    """
    total = along[0] * along[0]
    for axis in range(1, len(along)):  # to iterate over an array takes longer: it ends with an exception
        total += along[axis] * along[axis]
    return total


def squared_halves(states: States) -> tuple[Rows, Rows]:
    """‖r‖² and ‖v‖² of states (M, 2 axes), (M,) each."""
    squares, half = states * states, states.shape[1] // 2
    place, pace = squares[:, 0], squares[:, half]
    for axis in range(1, half):
        place, pace = place + squares[:, axis], pace + squares[:, half + axis]
    return place, pace


def dot(first: Floats, second: Floats) -> Rows:
    """Inner product over the last axis, `(...,)`.

    Products first, then NumPy's pairwise sum: its order is the same on every machine and for any number of rows,
    unlike that of a BLAS.
    """
    products: Rows = first * second
    if products.shape[-1] in (2, 3):  # faster than `reduce`, which starts at 0: without + 0.0, −0 could result
        total = products[..., 0] + products[..., 1]
        return (total if products.shape[-1] == 2 else total + products[..., 2]) + 0.0
    return np.add.reduce(products, axis=-1)


def inner(first: Vectors, second: Vectors) -> Rows:
    """Inner product of vectors that have few axes, `(...,)`: products along each axis, added in their order."""
    total: Rows = first[..., 0] * second[..., 0]
    for axis in range(1, first.shape[-1]):
        total += first[..., axis] * second[..., axis]
    return total


def cross_squared(first: Vectors, second: Vectors) -> Rows:
    """‖first × second‖², `(...,)`."""
    across = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    if first.shape[-1] == 2:
        return across * across
    x = first[..., 1] * second[..., 2] - first[..., 2] * second[..., 1]
    y = first[..., 2] * second[..., 0] - first[..., 0] * second[..., 2]
    return across * across + x * x + y * y


def length(vectors: Vectors) -> Rows:
    """‖·‖ of vectors, `(...,)`."""
    return np.sqrt(squared(parts(vectors)))


def speed(states: States) -> Rows:
    """‖v‖ in m/s, shape `(...,)`."""
    return length(velocity(states))


def norm(states: States) -> Rows:
    """‖s‖ as the paper prints it, mixing metres and m/s, shape `(...,)`; the destination test uses it."""
    return np.sqrt(dot(states, states))


def approach(first: Vectors, last: Vectors) -> Rows:
    """Least squared distance to the origin, `(...,)`, of points that move straight from `first` to `last`, `(..., d)`.

    NaN where a point has no beginning or no end.
    """
    step = last - first
    before = dot(first, step)
    after = dot(last, step)
    way = dot(step, step)
    ends = np.minimum(dot(first, first), dot(last, last))
    passing = (before < 0.0) & (after > 0.0)  # the nearest point is between the ends
    share = np.divide(-before, way, out=np.zeros_like(before), where=passing)
    nearest = first + share[..., None] * step
    return np.where(passing, np.minimum(ends, dot(nearest, nearest)), ends)
