"""Who met whom, and what: collisions, the closest approach of any two, obstacles that were hit. Kept in checkpoints."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario

Pair = tuple[int, int]


class Encounters:
    """Of one flight, every pair once, and every UAV with every disc once.

    collided: pairs that came within r_coll while both were on the way. touched: in the air, whatever they were, arrived
    or lost. hit: (N, K), which UAVs were within which discs.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.collided: set[Pair] = set()
        self.touched: set[Pair] = set()
        self._nearest_m = math.inf
        self._discs = mission.obstacles(scenario)
        self.hit = np.zeros((scenario.uavs, len(self._discs)), dtype=bool)

    @property
    def closest_approach_m(self) -> float | None:
        """The least distance of any two in the air; None where there never were two."""
        return self._nearest_m if math.isfinite(self._nearest_m) else None

    def meet(self, nearest_m: float, touching: NDArray[np.intp], flying: NDArray[np.bool_]) -> list[Pair]:
        """Takes an instant: the least distance, the pairs (K, 2) within r_coll, and who is on the way (N,).

        Returns:
            The pairs on the way that have not collided before.
        """
        self._nearest_m = min(self._nearest_m, nearest_m)
        new: list[Pair] = []
        if len(touching):
            for first, second in touching.tolist():
                self.touched.add((first, second))
                if flying[first] and flying[second] and (first, second) not in self.collided:
                    self.collided.add((first, second))
                    new.append((first, second))
        return new

    def enter(self, states: state.States, waiting: NDArray[np.bool_] | None) -> list[Pair]:
        """Takes where everyone is, (N, 4), but who is on the ground, (N,).

        Returns:
            UAV and disc, of those within one for the first time.
        """
        if not len(self._discs):
            return []
        x, y, radius = self._discs.T
        within = np.hypot(states[:, state.X, None] - x, states[:, state.Y, None] - y) < radius
        if waiting is not None:
            within[waiting] = False
        new = within & ~self.hit
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
        self._nearest_m = math.inf if snapshot["nearest_m"] is None else float(snapshot["nearest_m"])
        self.hit[...] = snapshot["hit"]
