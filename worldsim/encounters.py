"""Encounters of a flight: collisions, closest approach, obstacle hits. A checkpoint contains them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.metrics import Pairs

Pair = tuple[int, int]


class Encounters:
    """Encounters of one flight, every pair once, and every UAV with every disc once.

    collided: pairs that came within r_coll in a tick that both began on the way. touched: pairs of any UAVs in the air,
    arrived and lost ones too. hit: (N, K), which UAVs were within which discs. nearest_m: least distance of any two in
    the air, infinite if there never were two.

    UAVs move straight in a tick, so all of them are closest approaches of segments, not distances at ticks.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.collided: set[Pair] = set()
        self.touched: set[Pair] = set()
        self.nearest_m = math.inf
        self._discs = mission.obstacles(scenario)
        self.hit = np.zeros((scenario.uavs, len(self._discs)), dtype=bool)

    @property
    def closest_approach_m(self) -> float | None:
        """The least distance of any two in the air; None where there never were two."""
        return self.nearest_m if math.isfinite(self.nearest_m) else None

    def meet(self, seen: Pairs, on_way: NDArray[np.bool_]) -> list[Pair]:
        """Adds the close pairs of a tick; `on_way`: which UAVs were on the way when it began, (N,).

        Returns:
            The pairs on the way that have not collided before.
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
        """Adds the discs that UAVs entered on the way from `before` to `after`, (N, 4); NaN: the UAV enters none.

        Returns:
            UAV and disc, of those within one for the first time.
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
        """All of it, for `restore`."""
        return {
            "collided": sorted(self.collided),
            "touched": sorted(self.touched),
            "nearest_m": self.closest_approach_m,
            "hit": self.hit.astype("u1"),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on with a snapshot; KeyError or ValueError where it is of something else."""
        self.collided = {(first, second) for first, second in snapshot["collided"]}
        self.touched = {(first, second) for first, second in snapshot["touched"]}
        self.nearest_m = math.inf if snapshot["nearest_m"] is None else float(snapshot["nearest_m"])
        self.hit[...] = snapshot["hit"]
