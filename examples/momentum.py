"""An aggregation rule in a file: FedAvg with momentum at the leader (Hsu et al. 2019)."""

from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf


class Momentum(mf.Aggregator):
    name = "momentum"

    class Options(mf.Options, frozen=True):
        beta: Annotated[float, Meta(ge=0, lt=1, description="share of the last change that continues, 1")] = 0.5

    def init(self, parameters):
        return {"rounds": np.zeros(1), "model": np.zeros(parameters), "change": np.zeros(parameters)}

    def step(self, state, uploads):
        mean = uploads.mean
        if not state["rounds"][0]:  # the first model is the mean itself: there is no earlier model
            return {**state, "rounds": state["rounds"] + 1, "model": mean}, mean
        change = self.options.beta * state["change"] + mean - state["model"]
        model = state["model"] + change
        return {"rounds": state["rounds"] + 1, "model": model, "change": change}, model
