"""A controller whose model is too large to get through the default radio in one message."""

from typing import Any

import numpy as np

import meanflock as mf


class Large(mf.Controller):
    """Flies straight at the goal; shares 600 floats, of each UAV others, that nobody reads."""

    name = "large"
    parameters = 600

    def init(self, uavs: np.ndarray, initial_states: np.ndarray) -> dict[str, Any]:
        return {"model": uavs[:, None] + np.linspace(0.0, 1.0, self.parameters)}

    def step(self, memory: dict[str, Any], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        return mf.Step(memory, -0.02 * own[:, :2] - 0.3 * own[:, 2:])

    def get(self, memory: dict[str, Any]) -> np.ndarray:
        return memory["model"]

    def set(self, memory: dict[str, Any], rows: np.ndarray, models: np.ndarray) -> dict[str, Any]:
        model = memory["model"].copy()
        model[rows] = models
        return {**memory, "model": model}
