"""What controllers have in common whose UAVs broadcast their states and fly by those of the others."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.controllers.planned.trajectory import CRUISE_M_S
from meanflock.agent.controllers.sharing.neighbours import Neighbours
from meanflock.agent.controllers.travel import SLOWING_1_S, CruiseSpeed, Slowing, Travel, against_the_air
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.sharing import Sharing
from meanflock.swarm.state import States


class SharingController(Controller):
    """Base class of them: override `fly`, and `init` if it remembers more; options derive from `Sharing`."""

    Options: ClassVar[type[msgspec.Struct]] = Sharing
    broadcast_numbers = Neighbours.numbers
    pairwise = True
    diagnostics: tuple[str, ...] = ("unsent",)  # behind those of `fly`

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._neighbours, self._obstacles = Neighbours(options, scenario), mission.obstacles(scenario)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return self._neighbours.init(uavs, plan)

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        memory, refused = self._neighbours.receive(memory, tick, received)
        step = self.fly(memory, own, self._neighbours.states(memory, tick))
        memory, said = self._neighbours.speak(step.memory, tick, own)
        reported = self._neighbours.unsent(memory)
        if step.diagnostics is not None:
            reported = np.concatenate([step.diagnostics, reported], axis=1)
        return Step(memory, step.acceleration + against_the_air(self.scenario, own), reported, (said,), refused)

    @abstractmethod
    def fly(self, memory: Memory, own: States, others: States) -> Step:
        """Memory, acceleration as if there were no air, and diagnostics.

        Args:
            own: (M, 4). others: (M, N, 4), where each row takes all UAVs to be, itself as it last said.
        """
        raise NotImplementedError


class Travelling(Sharing, frozen=True):
    """The options of one that travels."""

    speed_m_s: CruiseSpeed = CRUISE_M_S
    slowing_1_s: Slowing = SLOWING_1_S


class TravellingController(SharingController):
    """Base class of those that would fly like `cruise` if they were alone; options derive from `Travelling`."""

    stays: ClassVar[bool] = False  # who has arrived where that was

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._travel = Travel(scenario, options.speed_m_s, options.slowing_1_s, self.stays)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return super().init(uavs, plan) | self._travel.init(uavs)
