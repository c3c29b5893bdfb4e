"""What the agents command and report of themselves: the numbers of their replies, each in the row of its UAV."""

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.worldsim.members import Member

Floats: TypeAlias = NDArray[np.float64]
Uavs: TypeAlias = NDArray[np.intp]

_NOBODY: Uavs = np.zeros(0, dtype=np.intp)


class Commands:
    """The commands that hold, and the diagnostics of the last tick.

    accelerations: (N, 2), m/s²; who does not reply goes on as before. diagnostics: (N, K), zeros of who does not reply.
    largest: (K,), of the |diagnostics| of the flight.
    """

    def __init__(self, uavs: int, diagnostics: int) -> None:
        self.accelerations: state.Plane = np.zeros((uavs, state.AXES))
        self.diagnostics: Floats = np.zeros((uavs, diagnostics))
        self.largest: Floats = np.zeros(diagnostics)

    def store(
        self, asked: Mapping[str, Member], replies: Mapping[str, Floats], awake: NDArray[np.bool_] | None
    ) -> Uavs:
        """Takes the numbers of nodes, each (M, 2 + K); returns the UAVs whose are beyond all bounds, which are not
        taken.

        `awake`: (N,), whose are; None for everyone's.
        """
        names = [name for name in asked if name in replies]
        if not names:
            self.diagnostics = np.zeros_like(self.diagnostics)
            return _NOBODY
        uavs = np.concatenate([asked[name].uavs for name in names])
        numbers = np.concatenate([replies[name] for name in names])
        sane = (np.abs(numbers) < BEYOND_SENSE).all(axis=-1)  # NaN is below nothing
        taken = sane if awake is None else sane & awake[uavs]
        rows, numbers = uavs[taken], numbers[taken]
        self.accelerations[rows] = numbers[:, : state.AXES]
        self.diagnostics = np.zeros_like(self.diagnostics)
        self.diagnostics[rows] = numbers[:, state.AXES :]
        self.largest = np.maximum(self.largest, np.abs(self.diagnostics).max(axis=0, initial=0.0))
        return uavs[~sane]
