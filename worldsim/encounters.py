"""Encounters: UAVs that come near each other, and UAVs that enter obstacles.

UAVs move straight within a tick, so encounters are closest approaches of segments, not distances at ticks.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Metrics, Scenario
from meanflock.swarm.stateful import Stateful
from meanflock.worldsim.obstacles import entered

Pair = tuple[int, int]

_ROOM = 64  # pairs that there is room for, beyond one for each UAV and those that are expected


class Pairs(NamedTuple):
    """Close pairs of one tick.

    near: number of pairs i < j within the hazard radius at the end of the tick.
    touching: (K, 2), ascending: pairs i < j that came within the collision radius during the tick.
    nearest_m: the least closest approach of any pair, or the given bound if that is less.
    """

    near: int
    touching: NDArray[np.intp]
    nearest_m: float


def pairs(metrics: Metrics, before: state.States, after: state.States, nearest_m: float, expected: int = 0) -> Pairs:
    """Measure a tick in which all UAVs move straight from `before` to `after`, both (N, 2d). Exact, over all pairs.

    A UAV with NaN in `before` approaches no other; one with NaN in `after` is left out. `nearest_m` bounds the
    closest approach that is looked for. More touching pairs than one a UAV beyond those `expected` take twice as long.
    """
    radii = (metrics.hazard_radius, metrics.collision_radius)
    found = np.empty((_ROOM + len(after) + expected, 2), dtype=np.intp)
    near, count, nearest_m = kernels.pairs(before, after, *radii, nearest_m, found)
    if count > len(found):
        found = np.empty((count, 2), dtype=np.intp)
        kernels.pairs(before, after, *radii, nearest_m, found)
    return Pairs(near, found[:count], nearest_m)


class Encounters(Stateful):
    """Encounters of one flight: each pair counts once, and each UAV once for each obstacle. A checkpoint contains them.

    Attributes:
        collided: pairs that came within r_coll in a tick that both began on the way.
        collided_at_ticks: those of them that were within r_coll at the end of such a tick.
        touched: pairs of any UAVs in the air that came within r_coll, arrived and lost UAVs included.
        hit: (N, K), whether a UAV was within an obstacle.
        nearest_m: least distance of any two UAVs in the air; infinite if there never were two.
        expected: number of pairs that may touch in the next tick: twice those of the last.
    """

    stored = ("collided", "collided_at_ticks", "touched", "closest_approach_m", "hit")

    def __init__(self, scenario: Scenario) -> None:
        self.collided: set[Pair] = set()
        self.collided_at_ticks: set[Pair] = set()
        self.touched: set[Pair] = set()
        self.nearest_m = math.inf
        self.expected = 0
        self._radius = scenario.metrics.collision_radius
        self._solids, self._polygons = mission.solids(scenario), mission.polygons(scenario)
        self.hit = np.zeros((scenario.uavs, len(self._solids)), dtype=bool)

    @property
    def closest_approach_m(self) -> float | None:
        """Least distance of any two UAVs in the air; None if there never were two."""
        return self.nearest_m if math.isfinite(self.nearest_m) else None

    @closest_approach_m.setter
    def closest_approach_m(self, distance: float | None) -> None:
        self.nearest_m = math.inf if distance is None else float(distance)

    def meet(self, seen: Pairs, on_way: NDArray[np.bool_], after: state.States) -> list[Pair]:
        """Add the close pairs of a tick.

        Args:
            on_way: (N,), UAVs that were on the way when it began. after: (N, 2d), states at its end.

        Returns:
            The pairs on the way that collide for the first time.
        """
        self.nearest_m = seen.nearest_m
        self.expected = 2 * len(seen.touching)
        if not len(seen.touching):
            return []
        first, second = seen.touching.T
        new: list[Pair] = []
        for pair, both in zip(
            map(tuple, seen.touching.tolist()), (on_way[first] & on_way[second]).tolist(), strict=True
        ):
            self.touched.add(pair)
            if both and pair not in self.collided_at_ticks:  # most pairs stay close for many ticks
                if math.dist(*state.position(after[[*pair]])) < self._radius:
                    self.collided_at_ticks.add(pair)
                if pair not in self.collided:
                    self.collided.add(pair)
                    new.append(pair)
        return new

    def enter(self, before: state.States, after: state.States) -> list[Pair]:
        """Add the obstacles that UAVs enter between `before` and `after`, (N, 2d) each; a UAV with NaN enters none.

        Returns:
            Pairs (UAV, obstacle) of UAVs that are within an obstacle for the first time.
        """
        if not len(self._solids):
            return []
        new = entered(self._solids, self._polygons, before, after) & ~self.hit
        if not np.count_nonzero(new):
            return []
        self.hit |= new
        return [(uav, obstacle) for uav, obstacle in np.argwhere(new).tolist()]
