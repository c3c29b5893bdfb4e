"""Plug-ins that meanflock leaves out: ways of averaging that the study of federations flies, for little or no gain.

Rules at the leader: the last upload of everybody, noise for differential privacy, and less weight for late uploads.
SCAFFOLD for the paper's networks, and a vehicle whose drag differs from UAV to UAV.
"""

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Memory, Received, Rows, Step
from meanflock.agent.controllers.mean_field.methods import MfgflHf
from meanflock.federation.rules import base
from meanflock.federation.rules.base import Aggregator, State, Uploads
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.worldsim.vehicles.base import Hidden
from meanflock.worldsim.vehicles.point_mass import PointMass

DELTA = 1e-3  # δ of differential privacy, far below one in 25 UAVs
SPREAD = 0.5  # of drags, as a share of their mean


class LastUpload(Aggregator):
    """The mean of the last model of each UAV, so that one that is lost counts as the one before."""

    name = "last-upload"

    def init(self, parameters: int) -> State:
        uavs = self.scenario.uavs
        return {"models": np.zeros((uavs, parameters)), "received": np.zeros(uavs, dtype=bool)}

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        models, received = state["models"].copy(), state["received"].copy()
        models[uploads.uavs], received[uploads.uavs] = uploads.models, True
        return {"models": models, "received": received}, models[received].mean(axis=0)


class Private(Aggregator):
    """Differential privacy of a UAV's uploads: each changes the global model by `clip` / S at most, and noise hides it.

    The noise of a round is z · `clip` / S. After T rounds the Rényi divergence of order α is at most α T / 2z² (Mironov
    2017), so ε = ρ + 2 √(ρ ln(1/δ)) with ρ = T / 2z², for the best α.
    """

    name = "private"

    class Options(base.Options, frozen=True):
        """Options of the rule."""

        epsilon: float
        clip: float = 0.3
        start: tuple[float, ...] = (0.3, 1.0, 0.0, 0.0)  # the model that everybody knows at take-off

    def init(self, parameters: int) -> State:
        return {"model": np.array(self.options.start)}

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        change = uploads.models - state["model"]
        size = np.linalg.norm(change, axis=1, keepdims=True)
        change = change * np.minimum(1.0, self.options.clip / np.maximum(size, 1e-12))
        draw = np.random.default_rng([self.scenario.seed, uploads.round])
        noise = self.noise() * self.options.clip / len(change) * draw.standard_normal(change.shape[1])
        model = state["model"] + change.mean(axis=0) + noise
        return {"model": model}, model

    def noise(self) -> float:
        """The multiplier z for all rounds of the flight."""
        rounds = self.scenario.duration / (self.scenario.period_ticks * self.scenario.dt)
        doubt = math.log(1.0 / DELTA)
        return math.sqrt(0.5 * rounds) / (math.sqrt(doubt + float(self.options.epsilon)) - math.sqrt(doubt))


class Aged(Aggregator):
    """The mean of the models, in which one of an earlier round counts 1 / √(1 + age), age in rounds."""

    name = "aged"

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats]:
        weights = 1.0 / np.sqrt(1.0 + uploads.round - uploads.sent)
        return state, weights @ uploads.models / weights.sum()


class MfgflHfScaffold(MfgflHf):
    """`mfgfl-hf` with control variates (SCAFFOLD, Karimireddy et al. 2020), for twice the bits.

    c_i is the mean change that the data of UAV i make to its weights in a tick, and c that of all UAVs. Every tick
    adds c − c_i to the weights. A UAV uploads its weights and its mean change in a tick since the last round, s; then
    c_i ← c_i − c + s.
    """

    name = "mfgfl-hf-scaffold"

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters, self.parts = 2 * self.weights, 2 * self.parts

    def init(self, uavs: NDArray[np.intp], plan: state.States) -> Memory:
        memory = super().init(uavs, plan)
        zeros = np.zeros_like(memory["weights"])
        return memory | {"start": memory["weights"], "mean": zeros, "own": zeros, "shared": zeros}

    def step(self, memory: Memory, tick: int, own: state.States, received: Sequence[Received]) -> Step:
        since = tick % self.scenario.period_ticks
        if since == 0 and tick:  # the upload is on its way
            variate = memory["own"] - memory["shared"] + memory["mean"]
            memory = memory | {"start": memory["weights"], "own": variate}
        stepped = super().step(memory, tick, own, received)
        weights = stepped.memory["weights"] + memory["shared"] - memory["own"]
        after = stepped.memory | {"weights": weights, "mean": (weights - memory["start"]) / (since + 1)}
        return msgspec.structs.replace(stepped, memory=after)

    def get(self, memory: Memory) -> Floats:
        return np.concatenate([memory["weights"], memory["mean"]], axis=1)

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        after = {name: memory[name].copy() for name in ("weights", "start", "shared")}
        after["weights"][rows], after["shared"][rows] = np.split(models, 2, axis=1)
        after["start"][rows] = after["weights"][rows]
        return memory | after


class MixedDrag(PointMass):
    """A point mass whose drag is that of the scenario on average, and from half to one and a half of it by UAV."""

    name = "mixed-drag"

    def step(
        self, states: state.States, hidden: Hidden, acceleration: state.Vectors, noise: state.Vectors
    ) -> tuple[state.States, Hidden]:
        more = self._wind.drag * SPREAD * np.linspace(-1.0, 1.0, len(states))[:, None]
        through = state.velocity(states) - self._mean(states)
        return super().step(states, hidden, acceleration - more * through, noise)
