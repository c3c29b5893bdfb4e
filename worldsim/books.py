"""Books of a flight: sums over its ticks, and the draws of its wind, made for a block of ticks at once.

The numbers are those of a tick at a time, to the last bit: sums go tick by tick, and draws are in the same order.
"""

import hashlib
import math
from typing import Any

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator, random_state, set_random_state
from meanflock.swarm.state import Floats, Mask
from meanflock.swarm.stateful import Stateful
from meanflock.worldsim.vehicles.base import Hidden
from meanflock.worldsim.vehicles.flown import FlownVehicles

_HASHED = np.dtype("<f8")
_BLOCK_TICKS = 50
_BLOCK_STATES = 2500  # a block has so many ticks, but not more states than this, so that it stays in the caches


def block_ticks(uavs: int) -> int:
    """Number of ticks in a block of so many UAVs."""
    return max(1, min(_BLOCK_TICKS, _BLOCK_STATES // uavs))


class TrajectoryHash:
    """SHA-256 of the states of all ticks, as little-endian float64.

    A copy or pickle has nothing of what was hashed, and cannot be used: see `Books.rehash`.
    """

    def __init__(self, states: state.States | None) -> None:
        """`states`: those of the first ticks; None for a hash that cannot be used."""
        self._hash: Any = None if states is None else hashlib.sha256(np.ascontiguousarray(states, dtype=_HASHED).data)

    def __reduce__(self) -> tuple[Any, ...]:
        return TrajectoryHash, (None,)

    def add(self, states: state.States) -> None:
        """Add the states of the next ticks, in order."""
        self._hash.update(states.astype(_HASHED, copy=False).data)

    @property
    def hexdigest(self) -> str:
        """The hash as text."""
        return str(self._hash.hexdigest())


class Books(Stateful):
    """Sums over the ticks of a flight. `add` enters a tick, and `settle` adds all entered ticks to the sums.

    Attributes, of the settled ticks:
        energy: (N,), J since take-off.
        distance: (N,), m flown until arrival.
        effort: (N,), sum of ‖a‖² over the ticks until arrival, m²/s⁴.
        speed_sum: (N,), sum of the speeds on the way, m/s.
        ticks_on_way: (N,), number of ticks on the way.
        speed_max: largest speed of a UAV on the way, m/s.
    """

    stored = ("energy", "distance", "effort", "speed_sum", "ticks_on_way", "speed_max")

    def __init__(self, scenario: Scenario, vehicles: FlownVehicles, states: state.States) -> None:
        """`states`: (N, 4), those of tick 0."""
        uavs = scenario.uavs
        self.energy = np.zeros(uavs)
        self.distance = np.zeros(uavs)
        self.effort = np.zeros(uavs)
        self.speed_sum = np.zeros(uavs)
        self.ticks_on_way = np.zeros(uavs, dtype=np.int64)
        self.speed_max = 0.0
        self._energies: list[Floats] | None = None  # arrays (k, N) after each tick, if somebody takes them
        self._dt = scenario.dt
        self._vehicles = vehicles
        self._most = block_ticks(uavs)
        self._hash = TrajectoryHash(states)
        # The entered ticks: states and hidden state after them, commands, and accelerations with gusts.
        self._states: list[state.States] = []
        self._hidden: list[Hidden] = []
        self._commands: list[state.Vectors] = []
        self._felt: list[state.Vectors] = []
        self._on_way: Mask = np.zeros(uavs, dtype=bool)
        self._waiting: Mask | None = None

    @property
    def hexdigest(self) -> str:
        """Hash of the states of all settled ticks, as little-endian float64."""
        return self._hash.hexdigest

    def add(
        self,
        states: state.States,
        hidden: Hidden,
        commands: state.Vectors,
        felt: state.Vectors,
        on_way: Mask,
        waiting: Mask | None,
    ) -> None:
        """Enter a tick. Only `commands` may change afterwards.

        Args:
            states: (N, 4) and `hidden`, after the tick. commands: (N, 2), m/s², as flown. felt: (N, 2), with gusts.
            on_way: (N,), UAVs on the way; another array if others are. waiting: (N,), UAVs on the ground, likewise;
                None for no UAV.
        """
        if on_way is not self._on_way or waiting is not self._waiting:
            self.settle()
            self._on_way = on_way
            self._waiting = waiting
        self._states.append(states)
        self._hidden.append(hidden)
        self._commands.append(commands.copy())
        self._felt.append(self._commands[-1] if felt is commands else felt)
        if len(self._states) == self._most:
            self.settle()

    def settle(self) -> None:
        """Add the entered ticks to the sums.

        Raises:
            RunFailed: the power of the vehicle is invalid.
        """
        if not self._states:
            return
        shape = len(self._states), len(self.energy)  # ticks, UAVs
        states = np.concatenate(self._states)  # rows of all UAVs, tick by tick, like those of all that follow
        hidden = {name: np.concatenate([each[name] for each in self._hidden]) for name in self._hidden[0]}
        commands = np.concatenate(self._commands)
        felt = np.concatenate(self._felt)
        for block in (self._states, self._hidden, self._commands, self._felt):
            block.clear()
        self._hash.add(states)
        try:
            power = self._vehicles.power(states, hidden, felt).reshape(shape)
        except RunFailed:  # the last block of telemetry still has these ticks, with the energy before them
            if self._energies is not None:
                self._energies.append(np.repeat(self.energy[None], shape[0], axis=0))
            raise
        if self._waiting is not None:
            power = np.where(self._waiting, 0.0, power)
        energies = sums(self.energy, power * self._dt)
        self.energy = energies[-1]
        if self._energies is not None:
            self._energies.append(energies)
        speed = state.speed(states).reshape(shape) * self._on_way
        self.speed_max = max(self.speed_max, float(np.maximum.reduce(speed, axis=None)))
        self.speed_sum = sums(self.speed_sum, speed)[-1]
        self.distance = sums(self.distance, speed * self._dt)[-1]
        self.ticks_on_way = self.ticks_on_way + shape[0] * self._on_way
        squared = state.dot(commands, commands)
        self.effort = sums(self.effort, squared.reshape(shape) * self._on_way)[-1]

    def keep_energies(self, *, with_first: bool) -> None:
        """From now on, store the energies after each tick, for `take_energies`; `with_first`: also those of now."""
        self._energies = [self.energy[None].copy()] if with_first else []

    def take_energies(self, ticks: int) -> Floats:
        """The energies after the next so many ticks that were not taken yet, (ticks, N)."""
        assert self._energies is not None
        self.settle()
        energies = np.concatenate([np.zeros((0, len(self.energy))), *self._energies])
        self._energies = [energies[ticks:]]
        return energies[:ticks]

    def rehash(self, history: Floats) -> None:
        """Begin the hash anew with the states (tick + 1, N, 4) of all settled ticks."""
        self._hash = TrajectoryHash(history)


def sums(begin: Floats, rows: Floats) -> Floats:
    """Sums of `begin` (N,) and the first, the first two, … of rows (k, N), in this order: (k, N)."""
    result = rows.copy()
    result[0] += begin
    return np.add.accumulate(result, axis=0) if len(result) > 1 else result  # one row of many UAVs takes long there


class Noise(Stateful):
    """Standard normal numbers of the motion, (N, 2) in each tick. Those of two UAVs correlate with `wind.common`.

    With a common part each tick draws a row more, after those of the UAVs, which all UAVs share.
    """

    stored = ("draw",)

    def __init__(self, scenario: Scenario) -> None:
        self._draw = generator(scenario.seed, "wind")
        self._common = scenario.wind.common
        self._shape = block_ticks(scenario.uavs), scenario.uavs + (self._common > 0), scenario.dimensions
        self._begin = random_state(self._draw)  # before the block
        self._block = np.zeros((0, *self._shape[1:]))
        self._used = 0

    def next(self) -> state.Vectors:
        """The numbers of the next tick."""
        if self._used == len(self._block):
            self._begin = random_state(self._draw)
            self._block = self._draw.standard_normal(self._shape)
            self._used = 0
        self._used += 1
        drawn = self._block[self._used - 1]
        if self._common == 0:
            return drawn
        return math.sqrt(1.0 - self._common) * drawn[:-1] + math.sqrt(self._common) * drawn[-1]

    @property
    def draw(self) -> dict[str, Any]:
        """State of the generator after the numbers used; it does not depend on the length of a block."""
        draw = generator(0, "wind")
        set_random_state(draw, self._begin)
        draw.standard_normal((self._used, *self._shape[1:]))
        return random_state(draw)

    @draw.setter
    def draw(self, state: dict[str, Any]) -> None:
        set_random_state(self._draw, state)
        self._begin = state
        self._block = self._block[:0]
        self._used = 0
