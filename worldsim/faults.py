"""The fault script of a flight: the faults of a tick, as masks and forces that the world applies in a fixed order."""

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.base import NoiseSources
from meanflock.channel.medium import Cut, Indices
from meanflock.federation.seat import missing_stations
from meanflock.swarm import state
from meanflock.swarm.events import FaultBegan, FaultEnded, FaultNeverBegins, FlightEvent
from meanflock.swarm.events.base import listed
from meanflock.swarm.faults import (
    Fault,
    Gust,
    Interference,
    Jam,
    Kill,
    LeaderLoss,
    Partition,
    Pause,
    kind,
    nodes_hit,
    paused,
)
from meanflock.swarm.mission import stations
from meanflock.swarm.scenario import Scenario


class Script:
    """The faults of one scenario. They depend on the tick only, so a resumed run continues with them."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._dt = scenario.dt
        self._faults = scenario.faults

    def events(self, tick: int) -> list[FlightEvent]:
        """Faults that begin or end in a tick, one event each; in tick 0 also those that never begin."""
        found: list[FlightEvent] = [*never(self._scenario)] if tick == 0 else []
        for number, fault in enumerate(self._faults):
            uavs = getattr(fault, "uavs", ())
            if fault.begins(self._dt) == tick:
                found.append(FaultBegan(tick, uavs, number, words(fault)))
            if fault.ends(self._dt) == tick and hasattr(fault, "duration_s"):
                found.append(FaultEnded(tick, uavs, number, words(fault)))
        return found

    def killed(self, tick: int) -> NDArray[np.intp]:
        """UAVs that are killed at the beginning of a tick, ascending."""
        dying = {uav for fault in self._acting(tick) if isinstance(fault, Kill) for uav in fault.uavs}
        return np.array(sorted(dying), dtype=np.intp) if dying else state.NO_UAV

    def leaders_lost(self, tick: int) -> int:
        """Number of leaders that are lost at the beginning of a tick."""
        return sum(isinstance(fault, LeaderLoss) for fault in self._acting(tick))

    def paused(self, tick: int) -> NDArray[np.bool_]:
        """(N,), UAVs that keep their last command and neither receive, send nor learn."""
        mask = np.zeros(self._scenario.uavs, dtype=bool)
        mask[paused(self._faults, tick, self._dt)] = True
        return mask

    def present_stations(self, tick: int) -> NDArray[np.bool_]:
        """(B,), stations that are neither lost nor paused in a tick."""
        present = np.ones(len(self._scenario.stations), dtype=bool)
        present[missing_stations(self._scenario, tick)] = False
        return present

    def cut(self, tick: int, states: state.States) -> Cut | None:
        """Function that says which links fail with the UAVs at `states` (N, 4); None: no link fails."""
        acting = [fault for fault in self._acting(tick) if isinstance(fault, Partition | Jam)]
        if not acting:
            return None

        def fails(sources: Indices, targets: Indices) -> NDArray[np.bool_]:
            failed = np.zeros(len(sources), dtype=bool)
            for fault in acting:
                named = np.zeros(self._scenario.nodes, dtype=bool)
                named[nodes_hit(fault, self._scenario.uavs)] = True
                if isinstance(fault, Partition):
                    failed |= named[sources] | named[targets]
                else:
                    failed |= named[sources] & named[targets]
                    inside = np.concatenate([_inside(fault, states), self._stations_inside(fault)])
                    failed |= inside[sources] | inside[targets]
            return failed

        return fails

    def noise(self, tick: int) -> NoiseSources | None:
        """Jammers that send noise in a tick, (J, 5): place in m, power in dBm and band in Hz; None for none."""
        acting = [fault for fault in self._acting(tick) if isinstance(fault, Interference)]
        if not acting:
            return None
        return np.array([(*fault.place, fault.power_dbm, fault.bandwidth_hz) for fault in acting])

    def gust(self, tick: int, states: state.States) -> state.Vectors | None:
        """(N, d), m/s², the acceleration of each UAV by gusts; None without gusts."""
        acting = [fault for fault in self._acting(tick) if isinstance(fault, Gust)]
        if not acting:
            return None
        pushed = np.zeros((len(states), state.axes(states)))
        for fault in acting:
            hit = _inside(fault, states)
            hit[list(fault.uavs)] = True
            if not fault.uavs and fault.centre is None:
                hit[:] = True
            pushed[hit] += self._scenario.space.vector(fault.acceleration)
        return pushed

    def _stations_inside(self, fault: Jam) -> NDArray[np.bool_]:
        """(B,), stations in the area of a jam."""
        return _inside(fault, state.at_rest(stations(self._scenario)[:, :2]))

    def _acting(self, tick: int) -> list[Fault]:
        return [fault for fault in self._faults if fault.acts(tick, self._dt)]


def _inside(fault: Jam | Gust, states: state.States) -> NDArray[np.bool_]:
    if fault.centre is None or fault.radius_m is None:
        return np.zeros(len(states), dtype=bool)
    from_centre = state.flat(states) - np.array(fault.centre)
    within: NDArray[np.bool_] = (from_centre * from_centre).sum(axis=-1) <= fault.radius_m**2
    return within


def never(scenario: Scenario) -> list[FaultNeverBegins]:
    """Events of faults that do not begin before the end of the longest flight."""
    dt, end = scenario.dt, scenario.max_ticks
    return [
        FaultNeverBegins(0, number, words(fault), fault.begins(dt) * dt, end * dt)
        for number, fault in enumerate(scenario.faults)
        if fault.begins(dt) >= end
    ]


def words(fault: Fault) -> str:
    """A fault in words: its kind, UAVs or place, and duration."""
    words = kind(fault)
    if uavs := getattr(fault, "uavs", ()):
        words += f" of {listed(uavs)}"
    if stations := getattr(fault, "stations", ()):
        words += f"{' and' if uavs else ' of'} station{'s' * (len(stations) > 1)} {', '.join(map(str, stations))}"
    if isinstance(fault, Jam | Gust) and fault.centre is not None:
        words += f" within {fault.radius_m:g} m of ({fault.centre[0]:g}, {fault.centre[1]:g}) m"
    if isinstance(fault, Gust):
        words += f" with ({', '.join(f'{along:g}' for along in fault.acceleration)}) m/s²"
    if isinstance(fault, Interference):
        words += f" of {fault.power_dbm:g} dBm from ({', '.join(f'{along:g}' for along in fault.place)}) m"
    if isinstance(fault, Pause | Partition | Jam | Interference | Gust):
        words += f" for {fault.duration_s:g} s"
    return words
