"""Encounters: close pairs of UAVs in a tick, and the collisions, closest approach and obstacle hits of a flight.

UAVs move straight within a tick, so all of these are closest approaches of segments, not distances at ticks.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Metrics, Scenario

Pair = tuple[int, int]

_ROOM = 64  # pairs that the first array has room for, beyond one for each UAV


class Pairs(NamedTuple):
    """Close pairs of one tick.

    near: number of pairs i < j within the hazard radius at the end of the tick.
    touching: (K, 2), ascending: pairs i < j that came within the collision radius during the tick.
    nearest_m: the least closest approach of any pair, or the given bound if that is less.
    """

    near: int
    touching: NDArray[np.intp]
    nearest_m: float


def pairs(metrics: Metrics, before: state.States, after: state.States, nearest_m: float) -> Pairs:
    """Measure a tick in which all UAVs move straight from `before` to `after`, both (N, 4). Exact, over all pairs.

    A UAV with NaN in `before` approaches no other; one with NaN in `after` is left out. `nearest_m` bounds the
    closest approach that is looked for.
    """
    radii = (metrics.hazard_radius, metrics.collision_radius)
    found = np.empty((_ROOM + len(after), 2), dtype=np.intp)
    near, count, nearest_m = kernels.pairs(before, after, *radii, nearest_m, found)
    if count > len(found):
        found = np.empty((count, 2), dtype=np.intp)
        kernels.pairs(before, after, *radii, nearest_m, found)
    return Pairs(near, found[:count], nearest_m)


class Encounters:
    """Encounters of one flight: each pair counts once, and each UAV once for each disc. A checkpoint contains them.

    Attributes:
        collided: pairs that came within r_coll in a tick that both began on the way.
        touched: pairs of any UAVs in the air that came within r_coll, arrived and lost UAVs included.
        hit: (N, K), whether a UAV was within a disc.
        nearest_m: least distance of any two UAVs in the air; infinite if there never were two.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.collided: set[Pair] = set()
        self.touched: set[Pair] = set()
        self.nearest_m = math.inf
        self._discs = mission.obstacles(scenario)
        self.hit = np.zeros((scenario.uavs, len(self._discs)), dtype=bool)

    @property
    def closest_approach_m(self) -> float | None:
        """Least distance of any two UAVs in the air; None if there never were two."""
        return self.nearest_m if math.isfinite(self.nearest_m) else None

    def meet(self, seen: Pairs, on_way: NDArray[np.bool_]) -> list[Pair]:
        """Add the close pairs of a tick; `on_way`: (N,), UAVs that were on the way when it began.

        Returns:
            The pairs on the way that collide for the first time.
        """
        self.nearest_m = seen.nearest_m
        new: list[Pair] = []
        for first, second in seen.touching.tolist():
            self.touched.add((first, second))
            if on_way[first] and on_way[second] and (first, second) not in self.collided:
                self.collided.add((first, second))
                new.append((first, second))
        return new

    def enter(self, before: state.States, after: state.States) -> list[Pair]:
        """Add the discs that UAVs enter between `before` and `after`, (N, 4) each; a UAV with NaN enters none.

        Returns:
            Pairs (UAV, disc) of UAVs that are within a disc for the first time.
        """
        if not len(self._discs):
            return []
        centres, radius = self._discs[:, : state.AXES], self._discs[:, state.AXES]
        first, last = (states[:, None, state.POSITION] - centres for states in (before, after))
        new = (state.approach(first, last) < radius * radius) & ~self.hit
        if not np.count_nonzero(new):
            return []
        self.hit |= new
        return [(uav, disc) for uav, disc in np.argwhere(new).tolist()]

    def snapshot(self) -> dict[str, Any]:
        """The encounters, for `restore`."""
        return {
            "collided": sorted(self.collided),
            "touched": sorted(self.touched),
            "nearest_m": self.closest_approach_m,
            "hit": self.hit.astype("u1"),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue with a snapshot; KeyError or ValueError if it does not fit."""
        self.collided = {(first, second) for first, second in snapshot["collided"]}
        self.touched = {(first, second) for first, second in snapshot["touched"]}
        self.nearest_m = math.inf if snapshot["nearest_m"] is None else float(snapshot["nearest_m"])
        self.hit[...] = snapshot["hit"]
