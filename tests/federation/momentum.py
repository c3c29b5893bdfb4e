"""A rule with a state, for tests."""

from typing import ClassVar

import numpy as np

from meanflock.federation.rules.base import Aggregator, State, Uploads
from meanflock.federation.rules.fedavg import mean


class Momentum(Aggregator):
    """The mean, moved on by half of how it moved last time."""

    name: ClassVar[str] = "momentum"

    def init(self, parameters: int) -> State:
        return {"last": np.zeros(parameters), "moved": np.zeros(parameters)}

    def step(self, state: State, uploads: Uploads) -> tuple[State, np.ndarray]:
        moved = mean(uploads.models) - state["last"] + 0.5 * state["moved"]
        last = state["last"] + moved
        return {"last": last, "moved": moved}, last
