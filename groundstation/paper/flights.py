"""Many flights of one scenario, seed by seed, advanced as one array. The books of each are kept by a `Flight`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarm import state
from swarm.scenario import Scenario
from worldsim.flight import Flight
from worldsim.physics import ARRIVING, DIVERGED, FLYING, Physics

Floats = NDArray[np.float64]

CHUNK_TICKS = 64  # wind is drawn and states are hashed this many ticks at a time


class _Row(Flight):
    """A flight whose arrays are rows of a batch. Rare events go through its own methods; `Flights` does the rest."""

    ARRAYS = (
        "states",
        "status",
        "energy",
        "arrival_tick",
        "arrival_energy",
        "distance",
        "_speed_sum",
        "_ticks_on_way",
    )

    def draw_wind(self, ticks: int) -> Floats:
        """What `advance` would draw in as many ticks, `(ticks, N, 2)`."""
        return self._wind.take(ticks * self.scenario.uavs).reshape(ticks, self.scenario.uavs, state.AXES)

    def hash_states(self, states: Floats) -> None:
        """The states of the next ticks, `(T, N, 4)`."""
        self._hash.update(states.astype("<f8", copy=False).tobytes())

    def touch(self, colliding: NDArray[np.intp]) -> None:
        """Pairs i < j within the collision radius now, `(K, 2)`."""
        self._collide(colliding)

    def land(self, new: NDArray[np.intp]) -> None:
        """These UAVs have come within the destination."""
        self._arrive(new)


class Flights:
    """R flights that took off together. Arrays have shape `(R, N, …)`, R shrinking as flights end.

    Every number is computed as `Flight.advance` would, on a row of the same length, so that each flight has the bits it
    would have alone.
    """

    def __init__(self, scenarios: list[Scenario]) -> None:
        """`scenarios`: equal but for the seed."""
        self.scenario = scenarios[0]
        self.tick = 0
        self._physics = Physics(self.scenario)
        self._rows = [_Row(scenario) for scenario in scenarios]
        self.states: state.States
        self.status: NDArray[np.uint8]
        self.energy: Floats
        self.arrival_tick: NDArray[np.int64]
        self.arrival_energy: Floats
        self.distance: Floats
        self._speed_sum: Floats
        self._ticks_on_way: NDArray[np.int64]
        self._bind({name: np.stack([getattr(row, name) for row in self._rows]) for name in _Row.ARRAYS})
        self.speed_difference_sum = np.array([row.speed_difference_sum for row in self._rows])
        self.near_sum = np.array([row.near_sum for row in self._rows])
        self.speed_max = np.array([row.speed_max for row in self._rows])
        self._history = np.empty((len(self._rows), CHUNK_TICKS, self.scenario.uavs, state.SIZE))
        self._filled = 0  # rows of the history not hashed yet
        self._noise = np.empty((0, len(self._rows), self.scenario.uavs, state.AXES))

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def over(self) -> NDArray[np.bool_]:
        """Which flights have ended, `(R,)`."""
        if self.tick >= self.scenario.max_ticks:
            return np.ones(len(self), dtype=bool)
        if self.scenario.stop == "duration":
            return np.zeros(len(self), dtype=bool)
        return ~(self.status == FLYING).any(axis=-1)

    @property
    def collisions(self) -> NDArray[np.int64]:
        """So far, `(R,)`."""
        return np.array([row.collisions for row in self._rows])

    def flight(self, row: int) -> Flight:
        """One flight, its books up to date."""
        self._hash()
        flight = self._rows[row]
        flight.tick = self.tick
        flight.speed_difference_sum = float(self.speed_difference_sum[row])
        flight.near_sum = int(self.near_sum[row])
        flight.speed_max = float(self.speed_max[row])
        return flight

    def lose(self, row: int, uavs: NDArray[np.intp], kind: str, why: str) -> None:
        """See `Flight.lose`."""
        self._rows[row].tick = self.tick
        self._rows[row].lose(uavs, kind, why)

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Drops the flights that ended; what `flight` gave of them stays as it was."""
        self._hash()
        self._rows = [row for row, kept in zip(self._rows, rows, strict=True) if kept]
        self._bind({name: getattr(self, name)[rows] for name in _Row.ARRAYS})
        self.speed_difference_sum = self.speed_difference_sum[rows]
        self.near_sum = self.near_sum[rows]
        self.speed_max = self.speed_max[rows]
        self._history = self._history[rows]
        self._noise = self._noise.compress(rows, axis=1)

    def advance(self, accelerations: Floats) -> None:
        """One tick of all flights under `accelerations` (R, N, 2), m/s²."""
        books = self.energy, self.distance, self._speed_sum, self._ticks_on_way
        moved = self._physics(self.states, self.status, accelerations, None, self._next_noise(), books)
        self.tick += 1
        if moved.incidents & DIVERGED:
            for row, uavs in _by_row(moved.marks & DIVERGED):
                self.lose(row, uavs, "diverged", "left every bound")
        self.states[...] = moved.states
        fastest, speed_difference, near = moved.numbers.T
        np.maximum(self.speed_max, fastest, out=self.speed_max)
        self.speed_difference_sum += speed_difference
        self.near_sum += near.astype(np.intp)
        if self._filled == CHUNK_TICKS:
            self._hash()
        self._history[:, self._filled] = moved.states
        self._filled += 1
        flights = moved.colliding[:, 0]
        for row in np.unique(flights) if len(flights) else ():
            self._rows[row].tick = self.tick
            self._rows[row].touch(moved.colliding[flights == row, 1:])
        if moved.incidents & ARRIVING:
            for row, uavs in _by_row(moved.marks & ARRIVING):
                self._rows[row].tick = self.tick
                self._rows[row].land(uavs)

    def _next_noise(self) -> Floats:
        used = self.tick % CHUNK_TICKS
        if not used:
            self._noise = np.stack([row.draw_wind(CHUNK_TICKS) for row in self._rows], axis=1)
        return self._noise[used]

    def _hash(self) -> None:
        for row, history in zip(self._rows, self._history, strict=True):
            row.hash_states(history[: self._filled])
        self._filled = 0

    def _bind(self, stacks: dict[str, NDArray]) -> None:
        for name, stack in stacks.items():
            setattr(self, name, stack)
            for row, of_row in zip(self._rows, stack, strict=True):
                setattr(row, name, of_row)


def _by_row(marked: NDArray[Any]) -> list[tuple[int, NDArray[np.intp]]]:
    """The flights in which anybody is marked, (R, N), and who."""
    return [(int(row), np.flatnonzero(marked[row])) for row in np.flatnonzero(marked.any(axis=-1))]
