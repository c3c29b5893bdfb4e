"""Linear-quadratic regulator: minimises ∫ q_r‖r‖² + q_v‖v‖² + ‖u‖² dt on the way to the goal.

Commands cancel drag and mean wind, so each axis is a double integrator. Its Riccati equation has the closed form
k_r = √q_r, k_v = √(q_v + 2 k_r) (Anderson and Moore, Optimal Control: Linear Quadratic Methods, 1990).
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.controllers.cruise import against_the_air
from meanflock.agent.controllers.goals import Goals
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import States, Vectors


class Lqr(Controller):
    """Linear-quadratic regulator to its goal; uses no states of other UAVs.

    a = −k_r (r − goal) − k_v v + c0 (v − v_o). It sends nothing.
    """

    name = "lqr"
    guided = True
    dimensions = (2, 3)
    broadcast_numbers = 0

    class Options(base.Options, frozen=True):
        """The options of `lqr`: weights relative to that of ‖u‖²."""

        position_weight: Annotated[float, Meta(gt=0, description="q_r, 1/s⁴")] = 1e-4
        velocity_weight: Annotated[float, Meta(ge=0, description="q_v, 1/s²")] = 0.07

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.gains = gains(options.position_weight, options.velocity_weight)
        self._goals = Goals(scenario)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return {"uav": uavs.astype(np.int32)} | self._goals.init(uavs)

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        return self._goals.guide(memory, rows, goals)

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        k_r, k_v = self.gains
        feedback = -k_r * (state.position(own) - self._goals.of(memory, memory["uav"])) - k_v * state.velocity(own)
        return Step(memory, feedback + against_the_air(self.scenario, own))


def gains(position_weight: float, velocity_weight: float) -> tuple[float, float]:
    """k_r in 1/s² and k_v in 1/s of a double integrator."""
    k_r = math.sqrt(position_weight)
    return k_r, math.sqrt(velocity_weight + 2.0 * k_r)
