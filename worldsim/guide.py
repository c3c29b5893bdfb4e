"""Guide: goals that change in flight, by waypoints, by times, and by batteries that are low."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import NO_UAV, Floats, Mask
from meanflock.swarm.stateful import Stateful


class _Way(NamedTuple):
    """Waypoints of the UAVs in some rows. places: (K, d) m. times_s: (K,), when the goal is there; none: a UAV that
    reaches one flies to the next. patrol: whether the first follows the last."""

    rows: slice
    places: Floats
    times_s: Floats
    patrol: bool


class Guide(Stateful):
    """The goals of all UAVs. A UAV whose battery is low flies to the nearest landing place.

    Attributes:
        is_there: whether any goal may change.
        goals: (N, 2d), as states at rest.
        leg: (N,), number of the waypoint to which each UAV flies. reached: number of waypoints that were reached.
        homeward: (N,), UAVs that return because their battery is low.
        landing: (N,), of them those that have reached the landing place, and land when the next tick begins.
        untold: (N,), UAVs that have not been told their goal yet.
    """

    stored = ("goals", "leg", "reached", "homeward", "landing", "untold")

    def __init__(self, scenario: Scenario) -> None:
        uavs = scenario.uavs
        self._dt = scenario.dt
        self._starts = state.position(mission.starts(scenario))
        self._landings = scenario.space.vectors(scenario.energy.landings, scenario.start.height)
        self._ways: list[_Way] = []
        for rows, table in mission.destinations(scenario):
            if len(table.waypoints):
                places = np.array(scenario.space.vectors(table.waypoints, scenario.start.height))
                self._ways.append(_Way(rows, places, np.array(table.times_s), table.patrol))
        self.is_there = scenario.is_guided
        self._no_news = NO_UAV, np.zeros((0, scenario.dimensions))
        self.goals = mission.goal_states(scenario)
        self.leg = np.zeros(uavs, dtype=np.int64)
        self.reached = 0
        self.homeward: Mask = np.zeros(uavs, dtype=bool)
        self.landing: Mask = np.zeros(uavs, dtype=bool)
        self.untold: Mask = np.zeros(uavs, dtype=bool)

    def news(self, awake: Mask) -> tuple[NDArray[np.intp], Floats]:
        """The UAVs (K,) among those that are awake (N,) that must be told their goals, and these (K, d), m."""
        if not self.is_there:
            return self._no_news
        uavs = np.flatnonzero(self.untold & awake)
        return uavs, state.position(self.goals[uavs])

    def told(self, heard: Mask) -> None:
        """UAVs (N,) have heard their goals."""
        self.untold &= ~heard

    def forget(self, uavs: NDArray[np.intp]) -> None:
        """UAVs have a new controller, which knows the first goals only."""
        if self.is_there:
            self.untold[uavs] = True

    def move(self, tick: int) -> None:
        """Moves goals that have times to where they are in a tick."""
        for way in self._ways:
            if not len(way.times_s):
                continue
            now = tick * self._dt
            if way.patrol:
                now %= way.times_s[-1]
            place = [np.interp(now, way.times_s, along) for along in way.places.T]
            rows = np.arange(way.rows.start, way.rows.stop)
            self._set(rows[~self.homeward[rows]], np.array(place))

    def reach(self, uavs: NDArray[np.intp], tick: int) -> NDArray[np.intp]:
        """UAVs have reached their goals in a tick. Returns those that have arrived, because no goal follows."""
        self.landing[uavs] = self.homeward[uavs]
        arrived = []
        for uav in uavs[~self.homeward[uavs]].tolist():
            way = next((way for way in self._ways if way.rows.start <= uav < way.rows.stop), None)
            if way is None:
                arrived.append(uav)
            elif len(way.times_s):
                if not way.patrol and tick * self._dt >= way.times_s[-1]:
                    self.reached += 1
                    arrived.append(uav)
            else:
                self.reached += 1
                following = int(self.leg[uav]) + 1
                if following == len(way.places) and not way.patrol:
                    arrived.append(uav)
                else:
                    self.leg[uav] = following % len(way.places)
                    self._set(np.array([uav]), way.places[self.leg[uav]])
        return np.array(arrived, dtype=np.intp)

    def send_home(self, uavs: NDArray[np.intp], positions: Floats) -> None:
        """Send UAVs at some positions (K, d), m, to their nearest landing places: those of the scenario, or their own
        starts."""
        self.homeward[uavs] = True
        for uav, position in zip(uavs.tolist(), positions, strict=True):
            place = self._starts[uav]
            if len(self._landings):
                place = self._landings[int(state.length(self._landings - position).argmin())]
            self._set(np.array([uav]), place)

    def _set(self, uavs: NDArray[np.intp], place: Any) -> None:
        state.position(self.goals)[uavs] = place
        self.untold[uavs] = True
