"""Obstacles that UAVs enter within a tick: discs and polygons of the plane, columns and spheres in space."""

from collections.abc import Mapping

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.polygons import Polygon
from meanflock.swarm.state import Floats, Mask, States, Vectors


def entered(solids: Floats, polygons: Mapping[int, Polygon], before: States, after: States) -> Mask:
    """Whether UAVs that move straight from `before` to `after`, (N, 2d) each, come into obstacles.

    Args:
        solids: (K, …), of `mission.solids`. polygons: of `mission.polygons`.

    Returns:
        (N, K). A UAV with NaN enters none.
    """
    ways = [state.position(states)[:, None] for states in (before, after)]
    inside = _within_round(solids, *ways)
    for number, polygon in polygons.items():
        ends = ways if state.axes(before) == state.PLANE else _below(np.array([[polygon.highest]]), *ways)
        inside[:, number] = polygon.is_entered(*(state.flat(end)[:, 0] for end in ends))
    return inside


def _within_round(solids: Floats, first: Vectors, last: Vectors) -> Mask:
    """Whether ways (N, 1, d) come into discs, columns and spheres, (N, K)."""
    if first.shape[-1] == state.PLANE:
        return _within(solids, first, last)
    is_column = solids[:, 3] < solids[:, 4]
    inside = np.empty((len(first), len(solids)), dtype=bool)
    columns, spheres = solids[is_column], solids[~is_column]
    inside[:, is_column] = _within(columns, *(state.flat(end) for end in _below(columns[:, 4, None], first, last)))
    inside[:, ~is_column] = _within(spheres, first, last)
    return inside


def _within(solids: Floats, first: Vectors, last: Vectors) -> Mask:
    """Whether ways (N, 1 or K, d) come within the radius of the centres (K, d), (N, K)."""
    centres, radius = state.flat(solids) if first.shape[-1] == state.PLANE else solids[:, [0, 1, 4]], solids[:, 2]
    return state.approach(first - centres, last - centres) < radius * radius


def _below(top: Floats, first: Vectors, last: Vectors) -> tuple[Vectors, Vectors]:
    """The parts of ways (N, 1, 3) at or below the tops (K, 1) of columns, (N, K, 3); NaN if there is none."""
    step, starts, ends = last - first, first[..., 2:] <= top, last[..., 2:] <= top
    crosses = starts != ends
    share = np.divide(top - first[..., 2:], step[..., 2:], out=np.zeros(crosses.shape), where=crosses)
    edge = first + share * step
    return np.where(starts, first, np.where(ends, edge, np.nan)), np.where(ends, last, edge)
