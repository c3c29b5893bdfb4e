"""The station that serves each UAV: the one whose signal is strongest, with a hysteresis, as in cellular networks."""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask
from meanflock.swarm.stateful import Stateful

HYSTERESIS_DB = 3.0  # by which another station must be stronger,
TICKS = 3  # for so many ticks on end


class Serving(Stateful):
    """The stations that serve the UAVs of a flight.

    Attributes:
        node: (N,) the node that serves each UAV: a station, or the UAV `federation.leader` while no station is present.
        handovers: changes so far from one station to another.
    """

    stored = ("node", "handovers", "_stronger")

    def __init__(self, scenario: Scenario) -> None:
        self._uavs, self._leader = scenario.uavs, scenario.federation.leader
        self.node: NDArray[np.intp] = np.full(scenario.uavs, scenario.federation.leader)
        self.handovers = 0
        self._stronger: NDArray[np.int64] = np.zeros(scenario.uavs, dtype=np.int64)  # ticks that another one was

    def update(self, signal_db: Floats, present: Mask, awake: Mask) -> None:
        """Takes the signals of a tick, (N, B) dB, of stations that are `present` (B,) at UAVs that are `awake` (N,)."""
        if not present.any():
            self.node = np.full(self._uavs, self._leader)
            return
        heard = np.where(present, signal_db, -np.inf)
        strongest = heard.argmax(axis=1)
        uavs, is_served = np.arange(self._uavs), self.node >= self._uavs
        station = np.where(is_served, self.node - self._uavs, 0)
        now = np.where(is_served, heard[uavs, station], -np.inf)
        is_stronger = heard[uavs, strongest] > now + HYSTERESIS_DB
        self._stronger = np.where(is_stronger, self._stronger + 1, 0)
        changes = (np.isneginf(now) | (self._stronger >= TICKS)) & (awake | ~is_served)
        self.handovers += int(np.count_nonzero(changes & is_served))
        self.node = np.where(changes, self._uavs + strongest, self.node)
        self._stronger[changes] = 0
