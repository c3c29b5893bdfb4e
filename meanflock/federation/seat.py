"""Seat: the node at which the leader averages a round, a UAV or a station. It follows from the scenario alone."""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.faults import Kill, Pause
from meanflock.swarm.scenario import Scenario


def order_of_seats(scenario: Scenario) -> NDArray[np.intp]:
    """The nodes (A,) at which the leader may average, in the order in which one follows another.

    The station `federation.station`, the stations after it, those before it, and last the UAV `federation.leader`;
    without `federation.station` that UAV alone.
    """
    uavs, federation = scenario.uavs, scenario.federation
    if federation.station is None:
        return np.array([federation.leader])
    stations = (federation.station + np.arange(len(scenario.stations))) % len(scenario.stations)
    return np.append(uavs + stations, federation.leader)


def seat(scenario: Scenario, tick: int = 0) -> int:
    """The node at which the leader averages the round that opens in a tick: the first one that is not lost or paused,
    else the last one."""
    if scenario.federation.station is None:
        return scenario.federation.leader
    missing = scenario.uavs + np.array(missing_stations(scenario, tick), dtype=np.intp)
    *ahead, last = order_of_seats(scenario).tolist()
    return next((node for node in ahead if node not in missing), last)


def missing_stations(scenario: Scenario, tick: int) -> list[int]:
    """The stations that are lost or paused in a tick, ascending."""
    return sorted(
        {
            station
            for fault in scenario.faults
            if (isinstance(fault, Kill) and fault.begins(scenario.dt) <= tick)
            or (isinstance(fault, Pause) and fault.acts(tick, scenario.dt))
            for station in fault.stations
        }
    )


def ticks_until_lost(scenario: Scenario) -> NDArray[np.intp]:
    """The tick in which each station is lost for good, (B,); one after all others for those that never are."""
    lost = np.full(len(scenario.stations), np.iinfo(np.intp).max)
    for fault in scenario.faults:
        if isinstance(fault, Kill):
            stations = list(fault.stations)
            lost[stations] = np.minimum(lost[stations], fault.begins(scenario.dt))
    return lost


def name_of(scenario: Scenario, node: int) -> str:
    """A node in words."""
    return f"UAV {node}" if node < scenario.uavs else f"station {node - scenario.uavs}"
