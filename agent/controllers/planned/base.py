"""What controllers have in common that follow trajectories which everybody knows before take-off, and say nothing."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Controller, Memory, Rows
from meanflock.agent.controllers.planned.trajectory import Trajectory
from meanflock.agent.controllers.prediction import AlongPlan
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import POSITION, VELOCITY, Floats, Mask, Plane, States


class Planned(Controller):
    """Base class of them; the cruise speed is their option `speed_m_s`."""

    broadcast_numbers = 0

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return {"uav": uavs.astype(np.int32)}

    @cached_property
    def _trajectory(self) -> Trajectory:
        return Trajectory(self.scenario, mission.starts(self.scenario), self.options.speed_m_s)

    def prediction(self) -> AlongPlan:
        """How others expect a UAV to go on that is off its trajectory: it comes back to it."""
        return AlongPlan(self._trajectory.states, self.scenario.dt)

    def _off(self, uavs: Rows, tick: int, own: States) -> tuple[Floats, Plane]:
        """How far off their trajectories rows (M, 4) are, (M, 2 axes, 2) m and m/s, and the accelerations there, (M, 2)
        m/s²."""
        position, velocity, acceleration = (ideal[uavs] for ideal in self._trajectory.at(tick))
        return np.stack([own[:, POSITION] - position, own[:, VELOCITY] - velocity], axis=-1), acceleration


class PlannedLearner(Planned):
    """Base class of those that learn to follow them: what they learn is an array of their memory, (M, weights), which
    the federation averages where their option `share` says so. The memory has the `tick` it last saw, too.
    """

    learned: ClassVar[str]  # the name of that array

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters = (self.weights or 0) if options.share else 0
        self._launches = mission.launches(scenario)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return super().init(uavs, plan) | {"tick": np.full(len(uavs), -2, dtype=np.int32)}

    def get(self, memory: Memory) -> Floats:
        return memory[self.learned][:, : self.parameters]

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        learned = memory[self.learned].copy()
        learned[rows] = models
        return memory | {self.learned: learned}

    def report(self, memory: Memory) -> Floats:
        return memory[self.learned]

    def _follows(self, memory: Memory, tick: int) -> Mask:
        """Whose last tick was the one before this, (M,): no pause in between, and not on the ground."""
        follows: Mask = (memory["tick"] == tick - 1) & (tick > self._launches[memory["uav"]])
        return follows
