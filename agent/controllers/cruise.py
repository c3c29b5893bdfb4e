"""Straight to the goal at the speed of least energy, blind to all others: what a swarm without a plan pays at least."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.controllers.planned.trajectory import CRUISE_M_S
from meanflock.agent.controllers.travel import SLOWING_1_S, CruiseSpeed, Slowing, Travel, against_the_air
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import VELOCITY, States


class Cruise(Controller):
    """Flies straight to its goal at one speed, and knows nothing of the others.

    a = k_v (v_ref − v) + c0 (v − v_o), v_ref = min(speed, slowing · distance) towards the goal. It stays where it
    arrives, and sends nothing.
    """

    name = "cruise"
    broadcast_numbers = 0

    class Options(base.Options, frozen=True):
        """The options of `cruise`."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        slowing_1_s: Slowing = SLOWING_1_S
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 1.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._travel = Travel(scenario, options.speed_m_s, options.slowing_1_s, stays=True)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return self._travel.init(uavs)

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        memory, wanted = self._travel.velocity(memory, own)
        acceleration = self.options.velocity_gain_1_s * (wanted - own[:, VELOCITY])
        return Step(memory, acceleration + against_the_air(self.scenario, own))
