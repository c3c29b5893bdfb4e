"""Who met whom, and what: collisions, the closest approach of any two, obstacles that were hit. Kept in checkpoints."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario

Pair = tuple[int, int]


class Encounters:
    """Of one flight, every pair once, and every UAV with every disc once."""

    def __init__(self, scenario: Scenario) -> None:
        self._collided: set[Pair] = set()  # while both were on the way
        self._touched: set[Pair] = set()  # whatever they were, arrived or lost
        self._nearest_m = math.inf
        self._discs = mission.obstacles(scenario)
        self._hit = np.zeros((scenario.uavs, len(self._discs)), dtype=bool)

    @property
    def collisions(self) -> int:
        """Pairs that came within r_coll while both were on the way."""
        return len(self._collided)

    @property
    def collisions_all(self) -> int:
        """Pairs that came within r_coll in the air, those with a UAV that had arrived or was lost too."""
        return len(self._touched)

    @property
    def closest_approach_m(self) -> float | None:
        """The least distance of any two in the air; None where there never were two."""
        return self._nearest_m if math.isfinite(self._nearest_m) else None

    @property
    def obstacle_hits(self) -> int:
        """UAVs that were within a disc, each disc once."""
        return int(np.count_nonzero(self._hit))

    def meet(self, nearest_m: float, touching: NDArray[np.intp], flying: NDArray[np.bool_]) -> list[Pair]:
        """Takes an instant: the least distance, the pairs (K, 2) within r_coll, and who is on the way (N,).

        Returns:
            The pairs on the way that have not collided before.
        """
        self._nearest_m = min(self._nearest_m, nearest_m)
        new: list[Pair] = []
        if len(touching):
            for first, second in touching.tolist():
                self._touched.add((first, second))
                if flying[first] and flying[second] and (first, second) not in self._collided:
                    self._collided.add((first, second))
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
        new = within & ~self._hit
        if not np.count_nonzero(new):
            return []
        self._hit |= new
        return [(uav, disc) for uav, disc in np.argwhere(new).tolist()]

    def snapshot(self) -> dict[str, Any]:
        """All of it, for `restore`."""
        return {
            "collided": sorted(self._collided),
            "touched": sorted(self._touched),
            "nearest_m": self.closest_approach_m,
            "hit": self._hit.astype("u1"),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on with a snapshot; KeyError or ValueError where it is of something else."""
        self._collided = {(first, second) for first, second in snapshot["collided"]}
        self._touched = {(first, second) for first, second in snapshot["touched"]}
        self._nearest_m = math.inf if snapshot["nearest_m"] is None else float(snapshot["nearest_m"])
        self._hit[...] = snapshot["hit"]
