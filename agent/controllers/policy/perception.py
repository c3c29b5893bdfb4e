"""Observations of a policy: its own state relative to the goal, and the nearest UAVs as the radio brought them.

A row of observations is, in m, m/s and s (in space with z and vz, too):

- x, y, vx, vy of the UAV, minus those of its goal at rest;
- for each of the K nearest UAVs, the nearest first: x, y, vx, vy of the other minus those of the UAV; the age of the
  last state that was received; 1; and the last message that was received, W numbers, 0 before the first one.

UAVs broadcast their states by the scenario's `[sharing]`. The other's state is predicted from the last one received, at
constant velocity. Before the first one it is the start, which all UAVs know. The columns of a UAV that is missing or
forgotten are 0, and so is the mask, the number after the age.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Broadcast, Memory, Received, of_kind
from meanflock.agent.controllers.goals import Goals
from meanflock.agent.controllers.sharing.base import FAR_M, NeighbourStates
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, States, Vectors

_AGE, _MASK, _MESSAGE = range(3)  # columns of another UAV behind its state; its message begins at the last
_STATE_NUMBER, _MESSAGE_NUMBER = 0, 1  # positions of the broadcasts of a tick


def width(neighbours: int, message: int, axes: int) -> int:
    """Numbers of an observation of so many neighbours, with messages of so many numbers."""
    return 2 * axes + neighbours * (2 * axes + _MESSAGE + message)


class Perception:
    """The observations of rows, and the broadcasts that others observe. Rows do not depend on each other."""

    def __init__(self, scenario: Scenario, neighbours: int, message: int) -> None:
        """`neighbours`: K. `message`: W, numbers of a message; 0: no messages."""
        self.neighbours = neighbours
        self.message = message
        self.broadcast_numbers = scenario.state_numbers + message
        self._others = NeighbourStates(scenario)
        self._goals = Goals(scenario)
        self._dt = scenario.dt

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """The memory of rows with numbers (M,) at take-off."""
        memory = self._others.init(uavs, plan) | self._goals.init(uavs)
        return memory | {"message": np.zeros((len(uavs), len(plan), self.message))} if self.message else memory

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        """The memory after some rows were given other goals, (len(rows), d) m."""
        return self._goals.guide(memory, rows, goals)

    def receive(self, memory: Memory, tick: int, received: Sequence[Received]) -> tuple[Memory, NDArray[np.int32]]:
        """The memory after the frames of a tick, and the senders of states that cannot be."""
        memory, refused = self._others.receive(memory, tick, received, _STATE_NUMBER)
        for frames in of_kind(received, self.message, np.float64, _MESSAGE_NUMBER) if self.message else ():
            sent, row = frames.links.T
            messages = memory["message"].copy()
            messages[row, frames.source[sent]] = frames.payload[sent]
            memory = memory | {"message": messages}
        return memory, refused

    def observe(self, memory: Memory, tick: int, own: States) -> Floats:
        """The observations of rows (M, 2d), (M, 2d + K (2d + 2 + W))."""
        uavs, rows = memory["neighbour_uav"], np.arange(len(own))[:, None]
        others = self._others.states(memory, tick)
        place = state.position(own)
        squared = state.squared([others[..., axis] - place[:, axis, None] for axis in range(place.shape[1])])
        squared[rows[:, 0], uavs] = np.inf
        count = min(self.neighbours, others.shape[1] - 1)
        which = np.argsort(squared, axis=1, kind="stable")[:, :count]
        numbers = own.shape[1]  # of a state
        seen = np.zeros((len(own), self.neighbours, numbers + _MESSAGE + self.message))
        near = seen[:, :count]
        near[..., :numbers] = others[rows, which] - own[:, None]
        near[..., numbers + _AGE] = (tick - memory["neighbour_tick"][rows, which]) * self._dt
        near[..., numbers + _MASK] = 1.0
        if self.message:
            near[..., numbers + _MESSAGE :] = memory["message"][rows, which]
        near[squared[rows, which] > 0.25 * FAR_M * FAR_M] = 0.0
        relative = own.copy()
        state.position(relative)[...] -= self._goals.of(memory, uavs)
        return np.concatenate([relative, seen.reshape(len(own), seen.shape[1] * seen.shape[2])], axis=1)

    def send(
        self, memory: Memory, tick: int, own: States, messages: Floats | None
    ) -> tuple[Memory, tuple[Broadcast, ...]]:
        """The memory after the broadcasts of a tick, and the broadcasts: states, then messages (M, W), if any."""
        memory, states = self._others.broadcast_states(memory, tick, own)
        return memory, (states,) if messages is None else (states, Broadcast(messages))
