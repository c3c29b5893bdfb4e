"""A controller with a long model."""

from typing import Any

import numpy as np

import meanflock as mf
from meanflock.swarm.scenario import Scenario
from tests.agent.large_model import Large


class Long(Large):
    """Its model, a part of which pulls the UAV, shrinks from round to round, so that there is something to average."""

    name = "long"
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        length: int = 3000
        decay: float = 0.999

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters, self.weights = options.length, 0
        self.parts = (options.length // 3, options.length - options.length // 3)

    def init(self, uavs: np.ndarray, initial_states: np.ndarray) -> dict[str, Any]:
        return {"model": np.stack([np.random.default_rng(int(uav)).normal(size=self.parameters) for uav in uavs])}

    def step(self, memory: dict[str, Any], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        pull = memory["model"][:, :2] * 0.01
        return mf.Step({"model": memory["model"] * self.options.decay}, pull - 0.05 * own[:, :2] - 0.3 * own[:, 2:])
