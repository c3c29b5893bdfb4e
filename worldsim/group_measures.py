"""Measures of each group of a flight that are measured in every tick: closest approaches and alignment."""

import math

import numpy as np

from meanflock import kernels
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.stateful import Stateful
from meanflock.worldsim.alignment import speed_difference

_NO_PAIRS = np.zeros((0, 2), dtype=np.intp)  # pairs that touch are not asked for


class GroupMeasures(Stateful):
    """Measures of the G groups of a flight, over its ticks.

    Attributes:
        nearest_m: (G,), least distance of two UAVs of a group in the air, also between ticks; infinite without two.
        speed_difference_sum: (G,), sum over ticks of the mean ‖v_j − v_i‖ over the pairs of a group, m/s.
        ticks: (G,), number of these ticks, in which a UAV of the group was in the air.
    """

    stored = ("closest_approaches_m", "speed_difference_sum", "ticks")

    def __init__(self, scenario: Scenario) -> None:
        self._rows = [rows for _, rows in mission.parts(scenario)]
        self._seed = scenario.seed
        self.nearest_m = np.full(len(self._rows), math.inf)
        self.speed_difference_sum = np.zeros(len(self._rows))
        self.ticks = np.zeros(len(self._rows), dtype=np.int64)

    def observe(self, tick: int, before: state.States, after: state.States, waiting: state.Mask | None) -> None:
        """Measures a tick in which UAVs move straight from `before` to `after`, (N, 2d).

        NaN in `before`: the UAV flew no segment; NaN in `after`: it is on the ground, one of the UAVs `waiting`, (N,).
        """
        for number, rows in enumerate(self._rows):
            begin, end = before[rows], after[rows]
            *_, self.nearest_m[number] = kernels.pairs(begin, end, 0.0, 0.0, self.nearest_m[number], _NO_PAIRS)
            aloft = end if waiting is None else end[~waiting[rows]]
            if len(aloft):
                self.speed_difference_sum[number] += speed_difference(aloft, self._seed, tick).mean
                self.ticks[number] += 1

    @property
    def closest_approaches_m(self) -> list[float | None]:
        """Least distance of two UAVs of each group; None if there never were two in the air."""
        return [distance if math.isfinite(distance) else None for distance in self.nearest_m.tolist()]

    @closest_approaches_m.setter
    def closest_approaches_m(self, distances: list[float | None]) -> None:
        for group, distance in zip(range(len(self._rows)), distances, strict=True):
            self.nearest_m[group] = math.inf if distance is None else distance

    def phi_a(self, group: int) -> float | None:
        """φ_A of a group, over the ticks in which it was in the air, m/s; None if it never was."""
        ticks = int(self.ticks[group])
        return float(self.speed_difference_sum[group]) / ticks if ticks else None
