"""The radios of all nodes, which may differ: of the UAVs, then of the stations."""

from typing import NamedTuple

import numpy as np

from meanflock.swarm.mission import uavs_of
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats


class Nodes(NamedTuple):
    """Radios of all nodes.

    power_dbm, gain_dbi, noise_figure_db, bandwidth_hz: (N + B,), the last one of what a node sends.
    """

    power_dbm: Floats
    gain_dbi: Floats
    noise_figure_db: Floats
    bandwidth_hz: Floats


def nodes_of(scenario: Scenario, gain_dbi: float = 0.0, noise_figure_db: float = 0.0) -> Nodes:
    """The radios of a scenario; gain and noise figure are of those for which it has none."""

    def by_node(common: float, key: str) -> Floats:
        values = np.full(scenario.nodes, common)
        for radio in scenario.radios:
            if (value := getattr(radio, key, None)) is not None:
                values[uavs_of(scenario, radio)] = value
        for node, station in enumerate(scenario.stations, start=scenario.uavs):
            if (value := getattr(station, key)) is not None:
                values[node] = value
        return values

    return Nodes(
        by_node(scenario.radio.tx_power_dbm, "tx_power_dbm"),
        by_node(gain_dbi, "gain_dbi"),
        by_node(noise_figure_db, "noise_figure_db"),
        by_node(scenario.radio.bandwidth_hz, "bandwidth_hz"),
    )
