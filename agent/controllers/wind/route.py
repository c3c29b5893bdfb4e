"""The cheapest way to a goal through a map of the wind, by dynamic programming (Bellman 1957) backwards from the goal.

A corridor has stations every few metres from the goal back, and places side by side at each station. A move leads
straight from a place to one of the nearest places at the next station, at the speed over ground that costs least.
"""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.wind.belief import WindGrid
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

SPEEDS_M_S = np.linspace(0.5, 6.0, 45)  # candidates of the speed over ground
SHORTEST_M = 1.0  # corridor
STATION_M, ABREAST_M = 6.0, 3.0
OFF_GOAL_J_M = 1.0  # penalty of a final metre off the goal; more than a metre of any way costs
REACH = 2  # largest sideways move between two stations, in places


class Fare:
    """Cost of a metre, energy plus μ × time in J, at the speed over ground of least cost."""

    def __init__(self, scenario: Scenario, time_price_w: float) -> None:
        """`time_price_w`: μ, cost of a second in addition to the energy, J."""
        self._vehicle, self._price = scenario.vehicle, time_price_w
        through_air = scenario.vehicle.power_speed == "air"
        self._in_any_wind = None if through_air else self._least(np.zeros(1), np.zeros(1))

    def best(self, along: Floats, across: Floats) -> tuple[Floats, Floats]:
        """The least cost, J/m, and the speed over ground, m/s, at which it is reached.

        Args:
            along, across: components of the wind in m/s, in the direction of flight and at right angles to it.
        """
        if self._in_any_wind is None:
            return self._least(along, across)
        cost, speed = self._in_any_wind
        return np.full(along.shape, cost), np.full(along.shape, speed)

    def _least(self, along: Floats, across: Floats) -> tuple[Floats, Floats]:
        least, best = np.full(along.shape, np.inf), np.full(along.shape, SPEEDS_M_S[0])
        sideways = across * across
        for speed in SPEEDS_M_S:  # one by one, so that all arrays stay in the cache
            headway = speed - along
            squared = headway * headway + sideways
            cost = (self._vehicle.power(squared, np.sqrt(squared)) + self._price) / speed
            best[cost < least] = speed
            np.minimum(least, cost, out=least)
        return least, best


class Corridor:
    """The corridor between starts and goals.

    goals: (N, 2) m. launches: (N,) ticks. goal: (2,) m, the middle of the goals. back: (2,) unit vector from it
        towards the starts. length_m: of the longest way.
    """

    def __init__(self, scenario: Scenario) -> None:
        starts = state.position(mission.starts(scenario))
        self.goals, self.launches = mission.goals(scenario), mission.launches(scenario)
        self.goal = self.goals.mean(axis=0)
        way = starts.mean(axis=0) - self.goal
        length = float(np.sqrt(state.dot(way, way)))
        self.back = way / length if length >= SHORTEST_M else np.array([1.0, 0.0])
        along = state.dot(starts - self.goals, np.broadcast_to(self.back, starts.shape))
        self.length_m = max(SHORTEST_M, float(along.max()))


class Router:
    """Cheapest ways along a corridor, to goals that may differ from row to row."""

    def __init__(self, fare: Fare, along: Floats, length_m: float, width_m: float, mean: Floats) -> None:
        """Args:
        along: (2,) unit vector from the goal back. length_m: of the longest way. width_m: to each side. mean: (2,)
            m/s, the wind on which maps are on top.
        """
        self._fare = fare
        self._along = along
        self._mean = mean
        self._across = np.array([-along[1], along[0]])
        self._middle = max(REACH, math.ceil(width_m / ABREAST_M))
        self.stations = max(2, math.ceil(length_m / STATION_M) + 1)
        self._offsets = ABREAST_M * np.arange(-self._middle, self._middle + 1)
        slope = ABREAST_M * np.arange(-REACH, REACH + 1) / STATION_M
        self._stretch = np.sqrt(1.0 + slope * slope)
        self._heading = (-along + slope[:, None] * self._across) / self._stretch[:, None]  # (moves, 2), to the goal

    def ways(self, grid: WindGrid, maps: Floats, goals: Floats, own: Floats) -> tuple[Floats, Floats]:
        """The way of each row: sideways offsets (M, S) m from the goal at each station, station 0 being the goal, and
        speeds over ground (M, S), m/s. Stations farther from the goal than the row have no meaning.

        Args:
            maps: (M, F, 2). goals, own: (M, 2) m, end and begin of the ways.
        """
        rows, row = len(maps), np.arange(len(maps))
        move, speed = self._policy(grid, maps, goals)
        station, offset = self.locate(own - goals)
        at = np.clip(np.rint(offset / ABREAST_M).astype(np.intp) + self._middle, 0, len(self._offsets) - 1)
        ways, speeds = np.zeros((rows, self.stations)), np.ones((rows, self.stations))
        first = np.clip(np.ceil(station / STATION_M).astype(np.intp), 1, self.stations - 1)
        for k in range(self.stations - 1, 0, -1):
            ways[:, k] = self._offsets[at]
            speeds[:, k] = speed[row, k, at]
            at = np.where(k <= first, np.clip(at + move[row, k, at], 0, len(self._offsets) - 1), at)
        speeds[:, 0] = speeds[:, 1]
        return ways, speeds

    def locate(self, off: Floats) -> tuple[Floats, Floats]:
        """Coordinates along and across the corridor, (M,) m each, of positions relative to the goal (M, 2)."""
        along, across = self._along, self._across
        return off[:, 0] * along[0] + off[:, 1] * along[1], off[:, 0] * across[0] + off[:, 1] * across[1]

    def ahead(self, ways: Floats, speeds: Floats, off: Floats, look_m: float) -> tuple[Floats, Floats]:
        """The point `look_m` ahead on the way, (M, 2) m relative to the goal, and the speed there, (M,) m/s."""
        station, _ = self.locate(off)
        row, last = np.arange(len(off)), self.stations - 1
        ahead = np.clip(station - look_m, 0.0, last * STATION_M) / STATION_M
        cell = np.minimum(ahead.astype(np.intp), last - 1)
        part = ahead - cell
        abreast = ways[row, cell] + part * (ways[row, cell + 1] - ways[row, cell])
        here = np.clip(np.ceil(station / STATION_M).astype(np.intp), 1, last)
        place = (ahead * STATION_M)[:, None] * self._along + abreast[:, None] * self._across
        return place, speeds[row, here]

    def _policy(self, grid: WindGrid, maps: Floats, goals: Floats) -> tuple[NDArray[np.intp], Floats]:
        """The best move (M, S, Y) from every place, in places sideways, and its speed (M, S, Y)."""
        rows, abreast = len(maps), len(self._offsets)
        moves = np.zeros((rows, self.stations, abreast), dtype=np.intp)
        speeds = np.ones((rows, self.stations, abreast))
        left = np.tile(OFF_GOAL_J_M * np.abs(self._offsets), (rows, 1))
        beyond = np.full((rows, REACH), np.inf)
        for k in range(1, self.stations):
            places = goals[:, None] + ((k - 0.5) * STATION_M) * self._along + self._offsets[:, None] * self._across
            wind = grid.at(maps, places) + self._mean  # halfway to the next station
            x, y = wind[..., :1], wind[..., 1:]
            along = x * self._heading[:, 0] + y * self._heading[:, 1]
            across = y * self._heading[:, 0] - x * self._heading[:, 1]
            a_metre, speed = self._fare.best(along, across)  # (M, Y, moves)
            padded = np.concatenate([beyond, left, beyond], axis=1)
            then = np.stack([padded[:, move : move + abreast] for move in range(2 * REACH + 1)], axis=-1)
            total = a_metre * (self._stretch * STATION_M) + then
            best = np.argmin(total, axis=-1)
            left = np.take_along_axis(total, best[..., None], axis=-1)[..., 0]
            moves[:, k], speeds[:, k] = best - REACH, np.take_along_axis(speed, best[..., None], axis=-1)[..., 0]
        return moves, speeds
