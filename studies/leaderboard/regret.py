"""Regret: what the UAVs of a flight used above the least that one UAV alone could have, in the time each took."""

from collections.abc import Mapping
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.studies.leaderboard.front import Front, cheapest, front
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario

Floats = NDArray[np.float64]


class Fronts:
    """The fronts of a scenario's UAVs, each worked out once."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self._corners = scenario, cheapest(scenario)
        blows = scenario.wind.mean if scenario.truth.wind is None else scenario.truth.wind
        self._wind = np.array(blows) if scenario.vehicle.power_speed == "air" else None

    @cached_property
    def each(self) -> list[Front] | None:
        """Of every UAV; None where the wind that power goes by is not the same everywhere."""
        if self.scenario.vehicle.power_speed == "air" and self.scenario.wind.field_rms > 0.0:
            return None
        ways = mission.goals(self.scenario) - mission.starts(self.scenario)[:, state.POSITION]
        of_way = cache(lambda *way: front(self.scenario, np.array(way), self._wind, self._corners))
        return [of_way(x, y) for x, y in ways.tolist()]

    def regret(self, kept: Mapping[str, Any]) -> float | None:
        """Mean over the UAVs of a flight, J; kept: of `flights.fly`. One that never arrived is taken by what it used
        until the end; None where one was lost, for which no time is known, or used less than the whole way takes."""
        if self.each is None or kept["lost"]:
            return None
        above = []
        for least, arrival, energy in zip(self.each, kept["travel_s"], kept["energy_J"], strict=True):
            above.append(energy - least.least_J(self.scenario.duration if arrival is None else arrival))
            if arrival is None and above[-1] < 0.0:  # it was cheap because it ended before it had flown
                return None
        return float(np.mean(above))

    def mean(self, times_s: Floats) -> Floats | None:
        """The least energies for the times (K,), mean of the UAVs, J; NaN where some UAV cannot be so fast."""
        if self.each is None:
            return None
        rows = [np.interp(times_s, each.times_s, each.energies_J, left=np.nan) for each in self.each]
        least: Floats = np.mean(rows, axis=0)
        return least
