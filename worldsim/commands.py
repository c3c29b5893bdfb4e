"""What the agents command and report of themselves: the numbers of their replies, each in the row of its UAV."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.swarm.state import Floats, Mask

Uavs: TypeAlias = NDArray[np.intp]


class Commands:
    """The commands that hold, and the diagnostics of the last tick.

    accelerations: (N, 2), m/s²; who does not reply goes on as before. diagnostics: (N, K), zeros of who does not reply.
    largest: (K,), of the |diagnostics| of the flight. summed: (K,), the diagnostics of UAVs on the way, over all ticks.
    """

    def __init__(self, uavs: int, diagnostics: int) -> None:
        self.accelerations: state.Plane = np.zeros((uavs, state.AXES))
        self.diagnostics: Floats = np.zeros((uavs, diagnostics))
        self.largest: Floats = np.zeros(diagnostics)
        self.summed: Floats = np.zeros(diagnostics)

    def store(self, numbers: Floats, replied: Mask, awake: Mask, on_way: Mask) -> Uavs:
        """Takes the numbers (N, 2 + K) of those that have `replied` and are `awake`; returns the UAVs whose are beyond
        all bounds, which are not taken. `on_way`: who has not arrived and is not lost; all three (N,).
        """
        sane = (np.abs(numbers) < BEYOND_SENSE).all(axis=-1)  # NaN is below nothing
        taken = (replied & awake & sane)[:, None]
        np.copyto(self.accelerations, numbers[:, : state.AXES], where=taken)
        self.diagnostics = np.where(taken, numbers[:, state.AXES :], 0.0)
        self.largest = np.maximum(self.largest, np.abs(self.diagnostics).max(axis=0, initial=0.0))
        self.summed = self.summed + np.add.reduce(self.diagnostics[on_way], axis=0)
        return np.flatnonzero(replied & ~sane)
