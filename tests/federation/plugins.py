"""Plug-ins of users for tests of the federation."""

from typing import Any

import numpy as np

import meanflock as mf
from meanflock.swarm.scenario import Scenario
from tests.agent.large_model import Large
from tests.pages import script_of

Momentum = script_of("momentum", "examples").Momentum  # a rule with a state
QSGD = script_of("qsgd", "examples").QSGD  # a coding of four bits, rounded at random
SignSGD = script_of("signsgd", "examples").SignSGD  # a coding of one bit


class Long(Large):
    """Its model, a part of which pulls the UAV, shrinks from round to round, so that there is something to average."""

    name = "long"
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        length: int = 3000
        decay: float = 0.999
        by_samples: bool = False

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters, self.weights = options.length, 0
        self.parts = (options.length // 3, options.length - options.length // 3)
        self.weighted = options.by_samples

    def init(self, uavs: np.ndarray, initial_states: np.ndarray) -> dict[str, Any]:
        models = [np.random.default_rng(int(uav)).normal(size=self.parameters) for uav in uavs]
        return {"model": np.stack(models), "samples": uavs + 1.0}

    def step(self, memory: dict[str, Any], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        pull = memory["model"][:, :2] * 0.01
        after = {**memory, "model": memory["model"] * self.options.decay}
        return mf.Step(after, pull - 0.05 * own[:, :2] - 0.3 * own[:, 2:])

    def samples(self, memory: dict[str, Any]) -> np.ndarray:
        return memory["samples"]
