"""Sum of the distances of all pairs of many points of a plane, in a time that is nearly proportional to their number.

This is the particle-particle, particle-mesh method (Hockney and Eastwood). The unit of length is the spacing of a mesh.
A distance is the difference of two parts, r = L(r) − n(r):

- L(r) = R P(r²/R²) below R, and r beyond, is smooth. P is Taylor's polynomial of √t about 1, of degree 7. Each point
  becomes weights of the 8 × 8 nodes around it, by Lagrange's interpolation. The sum over all pairs of nodes is a
  convolution, so a product after a Fourier transform.
- n(r) is 0 beyond R. It is summed over the pairs in neighbouring cells, in integers, whose sum does not depend on its
  order.

The error of a pair, in spacings of the mesh, is at most

- ε (1 + Λ + Λ² + Λ³) of L, which is interpolated along four coordinates. ε = max |Π (x − k)| M R⁻⁷ / 8! is the error
  along one of them, with M = max |∂⁸L/∂x⁸| = 13!! at R = 1, and Λ < 1.49 the sum of the magnitudes of the weights;
- R (1.5 · 2⁻²⁰ + 6 · 2⁻²⁴) of n: one and a half units of the integers, see `_REACH`, and single precision; and 2⁻²⁴ of
  the distances of both points from the centre, which are rounded.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Floats

SIDE = 256  # nodes of the mesh along an axis
CENTRE = 127.5
EXTENT = 124.0  # largest distance of a point from the centre along an axis: its 8 × 8 nodes are on the mesh
RADIUS = 12.0  # R
_PERIOD = 2 * SIDE  # of the Fourier transform: no pair of nodes is farther apart than half of it
_HALF = _PERIOD // 2 + 1  # the other frequencies of real numbers are conjugates of these
_POINTS = 8  # nodes of the interpolation along an axis, from the third one before the point to the fourth one after it
_BEFORE = 3
_INVERSE = (-1.0 / 5040, 1.0 / 720, -1.0 / 240, 1.0 / 144, -1.0 / 144, 1.0 / 240, -1.0 / 720, 1.0 / 5040)  # 1/Π (k − l)
_TAYLOR = (33.0 / 2048, -21.0 / 1024, 7.0 / 256, -5.0 / 128, 1.0 / 16, -1.0 / 8, 1.0 / 2, 1.0)  # of √t about 1
_SELF = RADIUS * (429.0 / 2048)  # L(0)
_UNIT = 2.0**20  # integers of n(r)/R
_CELL = 2  # spacings along a cell of near pairs
_CELLS = SIDE // _CELL
# Cells to either side of a cell, in its own row and in each of the next rows, that have points nearer than 5/6 R.
# Beyond this, n(r) is less than 1.5 units.
_REACH = (5, 5, 5, 5, 4, 3)


def distances(points: Floats) -> float | None:
    """Σ_{i < j} ‖p_j − p_i‖ of points (2, n) on the mesh; None if more than half of all pairs are near.

    The points are at most `EXTENT` from the centre (`CENTRE`, `CENTRE`) along each axis.
    """
    count = points.shape[1]
    cell = (points[1].astype(np.intp) // _CELL) * _CELLS + points[0].astype(np.intp) // _CELL
    order = np.argsort(cell, kind="stable")
    starts = np.zeros((_CELLS + len(_REACH)) * _CELLS + 1, dtype=np.intp)
    np.add.accumulate(np.bincount(cell, minlength=len(starts) - 1), out=starts[1:])
    rows = np.arange(len(_REACH))[:, None] * _CELLS
    reach = np.array(_REACH)[:, None]
    begin = starts[cell[order] + rows - reach]  # (6, n), of each point and row of cells: the first near point,
    begin[0] = np.arange(1, count + 1)
    end = starts[cell[order] + rows + reach + 1]  # and the one after the last
    if 4 * int(np.add.reduce(end - begin, axis=None)) > count * count:
        return None
    near = _near(((points - CENTRE) / RADIUS).astype(np.float32)[:, order], begin, end)
    smooth = 0.5 * (_energy(_spread(points)) - count * _SELF)
    return smooth - RADIUS * (near / _UNIT)


def _near(points: NDArray[np.float32], begin: NDArray[np.intp], end: NDArray[np.intp]) -> int:
    """Sum of n(r)/R, in units of 1/`_UNIT`, over points (2, n), in units of R, and those from `begin` to `end`."""
    left = np.tile(np.arange(points.shape[1]), len(begin))
    right, last = begin.ravel(), end.ravel()
    total = 0
    while len(left):
        ahead = right < last
        left = left[ahead]
        right = right[ahead]
        last = last[ahead]
        apart = points[:, right] - points[:, left]
        apart *= apart
        squared = np.minimum(apart[0] + apart[1], np.float32(1.0))
        part = (_taylor(squared) - np.sqrt(squared)) * np.float32(_UNIT) + np.float32(0.5)
        total += int(np.add.reduce(part.astype(np.int32), dtype=np.int64))
        right = right + 1
    return total


def _taylor(squared: NDArray) -> NDArray:
    """P(t), in the precision of t."""
    beyond = squared - squared.dtype.type(1.0)
    result = np.full_like(squared, _TAYLOR[0])
    for coefficient in _TAYLOR[1:]:
        result *= beyond
        result += squared.dtype.type(coefficient)
    return result


def _spread(points: Floats) -> Floats:
    """Weights of all nodes (SIDE, SIDE), y then x: the sums of those of the points (2, n)."""
    first = np.floor(points)
    weights = _weights(points - first)
    nodes = first.astype(np.intp)[:, :, None] + np.arange(-_BEFORE, _POINTS - _BEFORE)
    products = weights[1][:, :, None] * weights[0][:, None, :]
    places = nodes[1][:, :, None] * SIDE + nodes[0][:, None, :]
    sums = np.bincount(places.ravel(), products.ravel(), SIDE * SIDE)  # adds in the order of the points
    return sums.reshape(SIDE, SIDE).astype(np.float64, copy=False)


def _weights(part: Floats) -> Floats:
    """Lagrange's weights (…, 8) of the nodes around points that are a `part` (…) of the spacing beyond a node."""
    apart = part[..., None] - np.arange(-_BEFORE, _POINTS - _BEFORE)
    weights = np.empty_like(apart)
    product = np.ones_like(part)
    for k in range(_POINTS):
        weights[..., k] = product
        product = product * apart[..., k]
    product = np.ones_like(part)
    for k in reversed(range(_POINTS)):
        weights[..., k] *= product
        weights[..., k] *= _INVERSE[k]
        product = product * apart[..., k]
    return weights


def _energy(weights: Floats) -> float:
    """Σ w_g w_h L(‖g − h‖) over all ordered pairs of nodes (SIDE, SIDE)."""
    real, imaginary = _transformed(weights)
    power = (real * real + imaginary * imaginary) * _spectrum()
    return float(np.add.reduce(np.add.reduce(power, axis=0)))


@lru_cache(maxsize=1)
def _spectrum() -> Floats:
    """Fourier transform (PERIOD, HALF) of L, by which the squares of that of the weights are summed."""
    apart = np.minimum(np.arange(_PERIOD), np.arange(_PERIOD, 0, -1))
    squared = (apart * apart)[:, None] + (apart * apart).astype(np.float64)
    near = RADIUS * _taylor(squared / (RADIUS * RADIUS))
    real, _ = _transformed(np.where(squared < RADIUS * RADIUS, near, np.sqrt(squared)))
    real[:, 1:-1] *= 2.0
    real /= float(_PERIOD * _PERIOD)
    return real


def _transformed(values: Floats) -> Floats:
    """Fourier transform of real values (y, x), zero up to PERIOD along each axis: (2, PERIOD of x, HALF of y)."""
    rows = np.zeros((2, _PERIOD, values.shape[1]))
    rows[0, : len(values)] = values
    columns = np.zeros((2, _PERIOD, _HALF))
    columns[:, : values.shape[1]] = _fourier(rows)[:, :_HALF].transpose(0, 2, 1)
    return _fourier(columns)


def _fourier(values: Floats) -> Floats:
    """Fourier transform of each column of complex values (2, PERIOD, columns), [real, imaginary]; Stockham's."""
    cosine, sine = _roots()
    stride = 1
    while stride < _PERIOD:
        half = _PERIOD // 2 // stride
        first, second = values.reshape(2, 2, half, stride, -1).swapaxes(0, 1)
        c, s = (table[: _PERIOD // 2 : stride, None, None] for table in (cosine, sine))
        difference = first - second
        result = np.empty((2, half, 2, *first.shape[2:]))
        result[:, :, 0] = first + second
        result[0, :, 1] = difference[0] * c - difference[1] * s
        result[1, :, 1] = difference[0] * s + difference[1] * c
        values = result.reshape(values.shape)
        stride *= 2
    return values


@lru_cache(maxsize=1)
def _roots() -> Floats:
    """Cosines and sines, (2, HALF), of the first half of the roots of one, each between two others: a square root."""
    roots = np.array([[1.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
    while roots.shape[1] < _HALF:
        middle = roots[:, :-1] + roots[:, 1:]
        middle /= np.sqrt(middle[0] * middle[0] + middle[1] * middle[1])
        finer = np.empty((2, 2 * roots.shape[1] - 1))
        finer[:, ::2] = roots
        finer[:, 1::2] = middle
        roots = finer
    return roots
