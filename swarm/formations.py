"""The formations in which a swarm takes off: places in the plane, by `[start]` and the number of UAVs."""

import math
from typing import Any

import numpy as np

from meanflock.swarm.state import Floats

GRIDS = ("grid", "waves")  # whose distances are `start.spacing`, whatever somebody made of it
LANES = 4  # of a stream


def of(start: Any) -> str:
    """The formation of a `[start]`; unset, it is the paper's grid."""
    named: str | None = start.formation
    return named or "grid"


def places(start: Any, uavs: int) -> Floats:
    """Where so many UAVs stand, (N, 2) in m.

    grid: a square, centred; an N that is no square leaves the last row short: UAV k stands in column k mod w and row
    k div w of a grid w = ⌈√N⌉ wide. waves: the same with `start.group` columns, so that a wave is a row.
    circle: evenly on a circle of `start.radius`, UAV 0 at angle 0.
    streams: two, in lanes; the first, ⌈N/2⌉ UAVs, flies along x, the second along y; each begins around a point
    `start.radius` before the centre, where they cross.
    """
    kind, centre = of(start), np.array(start.centre)
    if kind == "circle":
        angle = 2.0 * math.pi * np.arange(uavs) / uavs
        return centre + start.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if kind == "streams":
        heading = headings(uavs)
        first = -(-uavs // 2)
        along = [_stream(count, start.spacing) for count in (first, uavs - first)]
        offset = np.concatenate([along[0], along[1][:, ::-1]])  # the other one along y
        return centre - start.radius * heading + offset
    width = start.group if kind == "waves" else math.isqrt(uavs - 1) + 1
    number, placed = np.arange(uavs), np.empty((uavs, 2))
    last_row = (uavs - 1) // width
    placed[:, 0] = start.centre[0] + start.spacing * (number % width - (width - 1) / 2)
    placed[:, 1] = start.centre[1] + start.spacing * (number // width - last_row / 2)
    return placed


def headings(uavs: int) -> Floats:
    """Unit vectors of two streams, (N, 2): the first ⌈N/2⌉ UAVs along x, the others along y."""
    first = np.arange(uavs) < -(-uavs // 2)
    return np.stack([first, ~first], axis=-1).astype(np.float64)


def _stream(uavs: int, spacing: float) -> Floats:
    """A stream along x about the origin, (n, 2): `LANES` abreast, row after row, the foremost first."""
    number, rows = np.arange(uavs), -(-uavs // LANES)
    along = spacing * ((rows - 1) / 2 - number // LANES)
    return np.stack([along, spacing * (number % LANES - (LANES - 1) / 2)], axis=-1)
