"""An aggregation rule in a file: Adam at the leader, on the change of the mean model (FedAdam, Reddi et al. 2021)."""

from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf


class FedAdam(mf.Aggregator):
    """Δ = mean − x;  m ← β₁ m + (1 − β₁) Δ;  v ← β₂ v + (1 − β₂) Δ²;  x ← x + η m / (√v + τ)."""

    name = "fedadam"

    class Options(mf.Options, frozen=True):
        eta: Annotated[float, Meta(gt=0, description="η, learning rate of the leader, in units of a weight")] = 0.05
        beta1: Annotated[float, Meta(ge=0, lt=1, description="β₁, share of m that goes on, 1")] = 0.9
        beta2: Annotated[float, Meta(ge=0, lt=1, description="β₂, share of v that goes on, 1")] = 0.99
        tau: Annotated[
            float, Meta(gt=0, description="τ, change below which steps get smaller, in units of a weight")
        ] = 1e-3

    def init(self, parameters):
        zeros = np.zeros(parameters)
        return {"rounds": np.zeros(1), "model": zeros, "m": zeros, "v": zeros + self.options.tau**2}

    def step(self, state, uploads):
        mean, given = uploads.mean, self.options
        if not state["rounds"][0]:  # the first model is the mean itself: there is no earlier model
            return {**state, "rounds": state["rounds"] + 1, "model": mean}, mean
        change = mean - state["model"]
        m = given.beta1 * state["m"] + (1.0 - given.beta1) * change
        v = given.beta2 * state["v"] + (1.0 - given.beta2) * change**2
        model = state["model"] + given.eta * m / (np.sqrt(v) + given.tau)
        return {"rounds": state["rounds"] + 1, "model": model, "m": m, "v": v}, model
