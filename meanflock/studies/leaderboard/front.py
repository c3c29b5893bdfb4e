"""The Pareto front of time and energy: the least energy that any flight of one UAV can use for the time it takes.

Energy is ∫P(‖v − w‖) dt, a function of the velocity alone: v over ground, w the wind where power goes by airspeed and
zero where it goes by ground speed. Let P** be the convex envelope of P as a radial function of the plane. A flight
that covers the displacement d in the time T has the mean velocity d/T, so by Jensen's inequality its energy is at least
T·P**(‖d/T − w‖); mixing the two speeds between which P** is straight attains it, but for the first and last moment.
The front is the minimum of that over all T up to the time taken, because a slower UAV can wait at the goal.

The vehicle has no limit of acceleration, so this is a bound and not a flight plan: flights that accelerate as craft do
come within a few per cent of it (a test flies some). Others in the air and obstacles only add to it.

In space power depends on the climb too, so there is no front of flights in space.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import mission, plugins, state
from meanflock.swarm.scenario import Scenario

Floats = NDArray[np.float64]

_SPEEDS = 12001  # number of speeds in the table of power
_SPEED_MAX = 60.0  # m/s, above all speeds of flights
_TIMES = 6000  # number of times of the front


def power(scenario: Scenario, speed: Floats) -> Floats:
    """Power of the scenario's vehicle in steady flight in W, at speeds (K,), m/s, over ground or through the air."""
    still = msgspec.structs.replace(scenario.vehicle, power_speed="ground")
    scenario = msgspec.structs.replace(scenario, vehicle=still)
    vehicle = plugins.create("vehicle", scenario.vehicle.model, scenario.vehicle.options, scenario)
    states = np.zeros((len(speed), scenario.state_numbers))
    state.velocity(states)[:, 0] = speed
    watts: Floats = vehicle.power(states, vehicle.init(len(speed)), np.zeros((len(speed), scenario.dimensions)))
    return watts


def envelope(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Corners of the convex envelope, in the plane, of a radial function that is y (K,) at the radii x (K,) ≥ 0,
    ascending from 0. It never decreases, because opposite velocities can be combined to a slower mean."""
    corners: list[tuple[float, float]] = []
    for right in zip(x.tolist(), np.minimum.accumulate(y[::-1])[::-1].tolist(), strict=True):
        while len(corners) > 1 and _above(corners[-2], corners[-1], right):
            corners.pop()
        corners.append(right)
    hull = np.array(corners)
    return hull[:, 0], hull[:, 1]


def _above(left: tuple[float, float], middle: tuple[float, float], right: tuple[float, float]) -> bool:
    """Returns whether the middle point is on or above the line between the others."""
    rise = (right[1] - left[1]) * (middle[0] - left[0])
    return (middle[1] - left[1]) * (right[0] - left[0]) >= rise


@dataclass(frozen=True)
class Front:
    """Least energies, J, for the times, s; both (K,), ascending."""

    times_s: Floats
    energies_J: Floats  # a unit

    def least_J(self, time_s: float) -> float:  # a unit
        """The least energy of a flight that takes so long; beyond the last time it falls no more."""
        return float(np.interp(time_s, self.times_s, self.energies_J))


def cheapest(scenario: Scenario) -> tuple[Floats, Floats]:
    """Corners of P** of the scenario's vehicle, m/s and W."""
    speeds = np.linspace(0.0, _SPEED_MAX, _SPEEDS)
    return envelope(speeds, power(scenario, speeds))


def front(
    scenario: Scenario,
    displacement: Floats,
    wind: Floats | None = None,
    corners: tuple[Floats, Floats] | None = None,
) -> Front:
    """The front of one UAV that is to be moved by `displacement` (2,), m, to within the destination's radius.

    Args:
        wind: (2,), m/s, if power depends on airspeed; None if it depends on ground speed. corners: of `cheapest`, if
            known already.
    """
    at, watts = corners or cheapest(scenario)
    air = np.zeros(2) if wind is None else np.asarray(wind, dtype=np.float64)
    radius = scenario.destination.radius
    way = max(float(np.hypot(*displacement)) - radius, 0.0)
    shortest = max(way / _SPEED_MAX, scenario.dt)
    times = np.geomspace(shortest, max(scenario.duration, 2.0 * shortest), _TIMES)
    mean = np.asarray(displacement, dtype=np.float64) / times[:, None] - air
    airspeed = np.maximum(np.hypot(mean[:, 0], mean[:, 1]) - radius / times, 0.0)
    energies = times * np.interp(airspeed, at, watts)
    if airspeed[0] > _SPEED_MAX:  # the envelope ends there
        times, energies = times[airspeed <= _SPEED_MAX], energies[airspeed <= _SPEED_MAX]
    return Front(times, np.minimum.accumulate(energies))


class Fronts:
    """Fronts of UAVs, and the regret: energy above the least that one UAV alone needs in the same time."""

    def __init__(self, scenario: Scenario, rows: slice = slice(None)) -> None:
        """`rows`: of the UAVs, which have the vehicle of the scenario."""
        self.scenario, self._rows = scenario, rows
        blows = scenario.wind.mean if scenario.truth.wind is None else scenario.truth.wind
        self._wind = np.array(blows) if scenario.vehicle.power_speed == "air" else None

    @cached_property
    def each(self) -> list[Front] | None:
        """Fronts of all these UAVs. None in space, if goals change in flight, if movement is recorded, and if power
        depends on a wind that varies from place to place.
        """
        is_recorded = self.scenario.vehicle.file is not None
        if self.scenario.dimensions == state.SPACE or self.scenario.is_guided or is_recorded:
            return None
        if self.scenario.vehicle.power_speed == "air" and self.scenario.wind.field_rms > 0.0:
            return None
        ways = (mission.goals(self.scenario) - state.position(mission.starts(self.scenario)))[self._rows]
        corners = cheapest(self.scenario)
        of_way = cache(lambda *way: front(self.scenario, np.array(way), self._wind, corners))
        return [of_way(x, y) for x, y in ways.tolist()]

    def regret(self, result: Mapping[str, Any]) -> float | None:
        """Mean regret of the UAVs of a flight, J; `result`: of `flights.fly`, or their part of it.

        A UAV that never arrived counts with its energy until the end. None if a UAV was lost, or ended with less energy
        than its whole way needs."""
        if self.each is None or result["lost"]:
            return None
        above = []
        for least, arrival, energy in zip(self.each, result["travel_s"], result["energy_J"], strict=True):
            above.append(energy - least.least_J(self.scenario.duration if arrival is None else arrival))
            if arrival is None and above[-1] < 0.0:  # it did not fly its whole way
                return None
        return float(np.mean(above))

    def mean(self, times_s: Floats) -> Floats | None:
        """The least energies for the times (K,), mean over the UAVs, J; NaN if a UAV cannot be so fast."""
        if self.each is None:
            return None
        rows = [np.interp(times_s, each.times_s, each.energies_J, left=np.nan) for each in self.each]
        least: Floats = np.mean(rows, axis=0)
        return least
