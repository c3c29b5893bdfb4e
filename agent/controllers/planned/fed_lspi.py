"""Federated least-squares policy iteration: learns in flight to follow the plan, knowing neither drag nor wind.

Every UAV knows its trajectory (`trajectory.py`) and nothing of what moves it. It perturbs its commands at first, keeps
what follows from what, and every two seconds improves its four gains (`policy_iteration.py`), which the federation
averages: one UAV's data are few and noisy, the errors of twenty-five are nearly independent.
"""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Memory, Received, Step
from meanflock.agent.controllers.planned import policy_iteration as lspi
from meanflock.agent.controllers.planned.base import PlannedLearner
from meanflock.agent.controllers.planned.trajectory import CRUISE_M_S
from meanflock.agent.controllers.travel import CruiseSpeed
from meanflock.swarm import seeds, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats


class FedLspi(PlannedLearner):
    """Follows the trajectory of `plan` with gains that it learns by least-squares policy iteration.

    With `share = false` every UAV learns alone.
    """

    name = "fed-lspi"
    learned = "gains"
    weights = lspi.GAINS
    diagnostics = ("tracking_cost", "k1", "k2", "k3_x", "k3_y")
    period_ticks = 20

    class Options(base.Options, frozen=True):
        """What it learns with."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        share: Annotated[bool, Meta(description="whether the federation averages the gains")] = True
        discount: Annotated[float, Meta(gt=0, lt=1, description="γ, what the cost a tick later counts, 1")] = 0.95
        k1: Annotated[float, Meta(ge=0.02, le=10, description="first gain of the position error, 1/s²")] = 0.3
        k2: Annotated[float, Meta(ge=0.1, le=10, description="first gain of the velocity error, 1/s")] = 1.0
        exploration: Annotated[float, Meta(ge=0, le=3, description="std of the perturbation an axis, m/s²")] = 0.3
        exploration_time: Annotated[float, Meta(ge=0, description="how long it perturbs, s")] = 30.0
        period: Annotated[float, Meta(gt=0, description="between two improvements, where not federated, s")] = 2.0
        gain_factor: Annotated[float, Meta(gt=1, description="by which k1, k2 change at once at the most, 1")] = 2.0
        offset_change: Annotated[float, Meta(gt=0, description="by what k3 changes at once at the most, m/s²")] = 0.6
        limit: Annotated[float, Meta(gt=0, description="on the input an axis, m/s²")] = 3.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.period_ticks = max(1, round(options.period / scenario.dt))
        self._explores = round(options.exploration_time / scenario.dt)
        self._noise: dict[int, Floats] = {}

    def init(self, uavs: NDArray[np.intp], plan: state.States) -> Memory:
        rows, first = len(uavs), [self.options.k1, self.options.k2, 0.0, 0.0]
        return super().init(uavs, plan) | {
            "gains": np.tile(np.array(first), (rows, 1)),
            "squares": np.zeros((rows, lspi.PAIRS, lspi.PAIRS)),
            "steps": np.zeros((rows, lspi.PAIRS, lspi.STATES)),
            "error": np.zeros((rows, state.AXES, 2)),  # and input, of `tick`
            "input": np.zeros((rows, state.AXES)),
        }

    def step(self, memory: Memory, tick: int, own: state.States, received: Sequence[Received]) -> Step:
        uavs = memory["uav"]
        error, acceleration = self._off(uavs, tick, own)
        memory = self._learn(memory, tick, error)
        gains = memory["gains"]
        wanted = lspi.inputs(gains, error)
        if tick < self._explores:
            wanted = wanted + self.options.exploration * self._perturbation(uavs, tick)
        given = np.clip(wanted, -self.options.limit, self.options.limit)
        after = memory | {"error": error, "input": given, "tick": np.full(len(own), tick, dtype=np.int32)}
        reported = np.concatenate([lspi.tracking(error)[:, None], gains], axis=1)
        return Step(after, acceleration + given, reported)

    def _learn(self, memory: Memory, tick: int, error: Floats) -> Memory:
        """The memory with what the last tick showed, and in the tick before a round with better gains."""
        squares, steps = memory["squares"], memory["steps"]
        fresh = self._follows(memory, tick)
        if fresh.any():
            first, second = lspi.seen(memory["error"], memory["input"], error)
            squares = squares + np.where(fresh[:, None, None], first, 0.0)
            steps = steps + np.where(fresh[:, None, None], second, 0.0)
        memory = memory | {"squares": squares, "steps": steps}
        if (tick + 1) % self.period_ticks == 0:
            of = self.options
            better = lspi.improve(memory["gains"], squares, steps, of.discount, of.gain_factor, of.offset_change)
            memory = memory | {"gains": better}
        return memory

    def _perturbation(self, uavs: NDArray[np.int32], tick: int) -> Floats:
        """Standard normal numbers, (M, 2), of the UAVs in a tick."""
        return np.array([self._of(int(uav))[tick] for uav in uavs]).reshape(-1, state.AXES)

    def _of(self, uav: int) -> Floats:
        if uav not in self._noise:
            draw = seeds.generator(self.scenario.seed, "controller", uav)
            self._noise[uav] = draw.standard_normal((self._explores, state.AXES))
        return self._noise[uav]
