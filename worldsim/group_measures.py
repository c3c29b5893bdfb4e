"""Measures of each group of a flight that are measured in every tick: closest approaches and alignment."""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.kernels.all_pairs import FEW
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.stateful import Stateful
from meanflock.worldsim.alignment import EXACT, speed_difference

_ROOM = 64  # pairs that there is room for at first


class GroupMeasures(Stateful):
    """Measures of the G groups of a flight, over its ticks.

    Attributes:
        closest_m: (G,), least distance of a UAV of a group to any other one in the air; infinite before there is one,
            and in a flight of more than `EXACT` UAVs.
        speed_difference_sum: (G,), sum over ticks of the mean ‖v_j − v_i‖ over the pairs of a group, m/s.
        ticks: (G,), number of these ticks, in which a UAV of the group was in the air.
    """

    stored = ("closest_m", "speed_difference_sum", "ticks")

    def __init__(self, scenario: Scenario) -> None:
        self._rows = [rows for _, rows in mission.parts(scenario)]
        self._seed = scenario.seed
        self._compares = scenario.uavs <= EXACT
        self.closest_m = np.full(len(self._rows), math.inf)
        self.speed_difference_sum = np.zeros(len(self._rows))
        self.ticks = np.zeros(len(self._rows), dtype=np.int64)

    def observe(self, tick: int, before: state.States, after: state.States) -> None:
        """Measures a tick in which UAVs move straight from `before` to `after`, (N, 2d).

        NaN in `before`: the UAV flew no segment; NaN in `after`: it is on the ground.
        """
        for number, rows in enumerate(self._rows):
            if self._compares:
                self.closest_m[number] = closest_approach(before, after, rows, float(self.closest_m[number]))
            aloft = after[rows][~np.isnan(after[rows, 0])]
            if len(aloft):
                self.speed_difference_sum[number] += speed_difference(aloft, self._seed, tick).mean
                self.ticks[number] += 1

    def closest_approach_m(self, group: int) -> float | None:
        """Least distance of a UAV of a group to any other one; None if there never were two, or it is not measured."""
        closest = float(self.closest_m[group])
        return closest if math.isfinite(closest) else None

    def phi_a(self, group: int) -> float | None:
        """φ_A of a group, over the ticks in which it was in the air, m/s; None if it never was."""
        ticks = int(self.ticks[group])
        return float(self.speed_difference_sum[group]) / ticks if ticks else None


def closest_approach(before: state.States, after: state.States, rows: slice, bound_m: float) -> float:
    """Closest approach of a UAV in some rows to any other in a tick, or `bound_m` if that is less, m.

    States as for `GroupMeasures.observe`.
    """
    if math.isinf(bound_m) and math.isinf(bound_m := _first_bound(before, after, rows)):
        return bound_m
    uavs = np.arange(len(after)) if len(after) <= FEW else _within_reach(before, after, rows, bound_m)
    found = np.empty((_ROOM, 2), dtype=np.intp)  # pairs that come nearer, also those of other groups
    before, after = before[uavs], after[uavs]
    _, count, _ = kernels.pairs(before, after, 0.0, bound_m, bound_m, found)
    if not count:
        return bound_m
    if count > len(found):
        found = np.empty((count, 2), dtype=np.intp)
        kernels.pairs(before, after, 0.0, bound_m, bound_m, found)
    is_own = (uavs >= rows.start) & (uavs < rows.stop)
    pairs = found[:count]
    pairs = pairs[is_own[pairs].any(axis=1)]
    return min(bound_m, _least(before, after, *pairs.T)) if len(pairs) else bound_m


def _first_bound(before: state.States, after: state.States, rows: slice) -> float:
    """Closest approach of one UAV in some rows, m; infinite if none of them flies a segment, or no other UAV does."""
    fly = np.flatnonzero(~np.isnan(before[:, 0] + after[:, 0]))
    own = fly[(fly >= rows.start) & (fly < rows.stop)]
    return _least(before, after, own[0], fly[fly != own[0]]) if len(own) else math.inf


def _within_reach(before: state.States, after: state.States, rows: slice, reach_m: float) -> NDArray[np.intp]:
    """The UAVs whose boxes around their segments are within reach of that around those of some rows."""
    first, last = state.position(before), state.position(after)
    low, high = np.fmin(first, last), np.fmax(first, last)
    beyond = (low > np.fmax.reduce(high[rows]) + reach_m) | (high < np.fmin.reduce(low[rows]) - reach_m)
    return np.flatnonzero(~beyond.any(axis=1))


def _least(before: state.States, after: state.States, i: NDArray[np.intp] | np.intp, j: NDArray[np.intp]) -> float:
    """Least closest approach of pairs (K,) of UAVs, m; infinite for none."""
    first, last = state.position(before), state.position(after)
    squared = state.approach(first[j] - first[i], last[j] - last[i])
    return math.sqrt(float(np.fmin.reduce(squared, initial=math.inf)))
