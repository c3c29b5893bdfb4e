"""Straight flight at the best speed in the mean wind: the baseline for maps of the wind."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.controllers.cruise import SLOWING_1_S, against_the_air, limited, towards
from meanflock.agent.controllers.goals import Goals
from meanflock.agent.controllers.wind.route import Fare
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, States, Vectors, norm

LIMIT_M_S2 = 3.0


class Straight(Controller):
    """Flies straight to its goal at the speed that costs least in the mean wind of the scenario.

    a = k_v (v_ref − v) + c0 (v − v_o). It sends nothing. If goals change in flight, the speed is chosen in every tick.
    """

    name = "straight"
    guided = True
    broadcast_numbers = 0

    class Options(base.Options, frozen=True):
        """The options of `straight`."""

        time_price_w: Annotated[float, Meta(ge=0, description="cost of a second in addition to the energy, W")] = 0.05
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 1.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._goals, self._fare = Goals(scenario), Fare(scenario, options.time_price_w)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        memory: Memory = {"uav": uavs.astype(np.int32)} | self._goals.init(uavs)
        return memory | {"speed": self._best(self._goals.of(memory, uavs) - state.position(plan[uavs]))}

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        return self._goals.guide(memory, rows, goals)

    def _best(self, way: Vectors) -> Floats:
        """Speeds (M,), m/s, of least cost along ways (M, 2)."""
        heading = way / np.maximum(norm(way), 1e-9)[:, None]
        x, y = self.scenario.wind.mean
        along, across = x * heading[:, 0] + y * heading[:, 1], y * heading[:, 0] - x * heading[:, 1]
        return self._fare.best(along, across)[1]

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        goals = self._goals.of(memory, memory["uav"])
        if self._goals.are_guided:
            memory = memory | {"speed": self._best(goals - state.position(own))}
        wanted = towards(goals, own, memory["speed"], SLOWING_1_S)
        acceleration = self.options.velocity_gain_1_s * (wanted - state.velocity(own))
        return Step(memory, limited(acceleration, LIMIT_M_S2) + against_the_air(self.scenario, own))
