"""Flight along concurrent trajectories (Turpin, Michael and Kumar, Concurrent assignment and planning of trajectories
for large teams of robots, ICRA 2013): the controller `plan`, and the base classes of controllers that learn to do it.

All UAVs know all trajectories before take-off and send nothing in flight. A UAV's slot is its place in the formation,
which is shrunk about the goal. UAVs with the same goal are companions. The slot of a UAV without companions is its
goal.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller, Memory, Received, Rows, Step
from meanflock.agent.controllers.cruise import CRUISE_M_S, CruiseSpeed, against_the_air
from meanflock.agent.controllers.planned.trajectory import Trajectory
from meanflock.agent.controllers.prediction import AlongPlan
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import POSITION, VELOCITY, Floats, Mask, Plane, States


class Planned(Controller):
    """Base class of controllers that follow trajectories known to all; their option `speed_m_s` is the cruise speed."""

    broadcast_numbers = 0

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return {"uav": uavs.astype(np.int32)}

    @cached_property
    def _trajectory(self) -> Trajectory:
        return Trajectory(self.scenario, mission.starts(self.scenario), self.options.speed_m_s)

    def prediction(self) -> AlongPlan:
        """A UAV that is off its trajectory is predicted to return to it."""
        return AlongPlan(self._trajectory.states, self.scenario.dt)

    def _off(self, uavs: Rows, tick: int, own: States) -> tuple[Floats, Plane]:
        """Errors of rows (M, 4) to their trajectories, (M, 2 axes, 2) m and m/s; and accelerations there, (M, 2)."""
        position, velocity, acceleration = (ideal[uavs] for ideal in self._trajectory.at(tick))
        return np.stack([own[:, POSITION] - position, own[:, VELOCITY] - velocity], axis=-1), acceleration


class PlannedLearner(Planned):
    """Base class of controllers that learn to follow trajectories.

    The model is an array of the memory, (M, weights), which the federation averages if the option `share` says so. The
    memory also has the last `tick`.
    """

    learned: ClassVar[str]  # name of the array that is the model

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
        """Mask (M,) of the rows that flew in the tick before this one: neither paused nor on the ground."""
        follows: Mask = (memory["tick"] == tick - 1) & (tick > self._launches[memory["uav"]])
        return follows


class Plan(Planned):
    """Follows a trajectory computed before take-off; every UAV knows the trajectories of all.

    a = a* + k_p (r* − r) + k_v (v* − v) + c0 (v − v_o). It sends nothing.
    """

    name = "plan"

    class Options(base.Options, frozen=True):
        """The options of `plan`."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        position_gain_1_s2: Annotated[float, Meta(gt=0, description="k_p, 1/s²")] = 4.0
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 4.0

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        options = self.options
        off, acceleration = self._off(memory["uav"], tick, own)
        acceleration = acceleration - options.position_gain_1_s2 * off[..., 0] - options.velocity_gain_1_s * off[..., 1]
        return Step(memory, acceleration + against_the_air(self.scenario, own))


def tracking(error: Floats) -> Floats:
    """Cost ‖p‖² + ½‖v‖² of errors (M, 2 axes, 2) to the trajectory, `(M,)`."""
    each = error[..., 0] ** 2 + 0.5 * error[..., 1] ** 2
    total: Floats = each[..., 0] + each[..., 1]
    return total
