"""Measures of each group of a flight that are measured in every tick: closest approaches and alignment."""

import math

import numpy as np

from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.stateful import Stateful
from meanflock.worldsim.alignment import EXACT, speed_difference

_PAIRS = 200_000  # pairs that are compared at once


class GroupMeasures(Stateful):
    """Measures of the G groups of a flight, over its ticks.

    Attributes:
        closest_m: (N,), least distance of each UAV to any other one in the air; infinite before there is one. It stays
            so in a flight of more than `EXACT` UAVs.
        speed_difference_sum: (G,), sum over ticks of the mean ‖v_j − v_i‖ over the pairs of a group, m/s.
        ticks: (G,), number of these ticks, in which a UAV of the group was in the air.
    """

    stored = ("closest_m", "speed_difference_sum", "ticks")

    def __init__(self, scenario: Scenario) -> None:
        self._rows = [rows for _, rows in mission.parts(scenario)]
        self._seed = scenario.seed
        self._compares = scenario.uavs <= EXACT
        self.closest_m = np.full(scenario.uavs, math.inf)
        self.speed_difference_sum = np.zeros(len(self._rows))
        self.ticks = np.zeros(len(self._rows), dtype=np.int64)

    def observe(self, tick: int, before: state.States, after: state.States) -> None:
        """Measures a tick in which UAVs move straight from `before` to `after`, (N, 2d).

        NaN in `before`: the UAV flew no segment; NaN in `after`: it is on the ground.
        """
        if self._compares:
            self.closest_m = closest_of_each(before, after, self.closest_m)
        for number, rows in enumerate(self._rows):
            aloft = after[rows][~np.isnan(after[rows, 0])]
            if len(aloft):
                self.speed_difference_sum[number] += speed_difference(aloft, self._seed, tick).mean
                self.ticks[number] += 1

    def closest_approach_m(self, group: int) -> float | None:
        """Least distance of a UAV of a group to any other one; None if there never were two, or it is not measured."""
        closest = float(self.closest_m[self._rows[group]].min())
        return closest if math.isfinite(closest) else None

    def phi_a(self, group: int) -> float | None:
        """φ_A of a group, over the ticks in which it was in the air, m/s; None if it never was."""
        ticks = int(self.ticks[group])
        return float(self.speed_difference_sum[group]) / ticks if ticks else None


def closest_of_each(before: state.States, after: state.States, bound_m: Floats) -> Floats:
    """Closest approach of each UAV to any other in a tick, or its bound (N,) if that is less, m.

    States as for `GroupMeasures.observe`. Only pairs are compared that end so near each other that they may have been
    within a bound.
    """
    first, last = state.position(before), state.position(after)
    longest = float(np.fmax.reduce(state.length(last - first), initial=0.0))
    reach = bound_m + 2.0 * longest
    closest = bound_m.copy()
    rows = max(1, _PAIRS // len(last))
    for begin in range(0, len(last), rows):
        one = slice(begin, begin + rows)
        apart = [along[one, None] - along for along in state.parts(last)]
        i, j = (state.squared(apart) <= np.square(reach[one])[:, None]).nonzero()
        i, j = i[i + begin != j] + begin, j[i + begin != j]
        np.fmin.at(closest, i, np.sqrt(state.approach(first[j] - first[i], last[j] - last[i])))
    return closest
