"""Many flights of one scenario that took off together, seed by seed; their arrays as one."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarm import state
from swarm.scenario import Scenario
from worldsim.flight import Flight

Floats = NDArray[np.float64]


class Flights:
    """R flights, R shrinking as they end."""

    def __init__(self, scenarios: list[Scenario]) -> None:
        """`scenarios`: equal but for the seed."""
        self._rows = [Flight(scenario) for scenario in scenarios]

    def __len__(self) -> int:
        return len(self._rows)

    def __getattr__(self, name: str) -> NDArray[Any]:
        """What the flights have under this name, `(R, …)`: states, status, energy, collisions …"""
        if name.startswith("_"):
            raise AttributeError(name)
        return np.array([getattr(row, name) for row in self._rows])

    @property
    def tick(self) -> int:
        """The same of all."""
        return self._rows[0].tick

    def flight(self, row: int) -> Flight:
        """One of them."""
        return self._rows[row]

    def lose(self, row: int, uavs: NDArray[np.intp], kind: str, why: str) -> None:
        """See `Flight.lose`."""
        self._rows[row].lose(uavs, kind, why)

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Drops the flights that ended."""
        self._rows = [row for row, kept in zip(self._rows, rows, strict=True) if kept]

    def advance(self, accelerations: state.Plane) -> None:
        """One tick of all flights under `accelerations` (R, N, 2), m/s²."""
        for row, asked in zip(self._rows, accelerations, strict=True):
            row.advance(asked)
            row.events.clear()
