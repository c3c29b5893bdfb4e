"""A controller that learns: each UAV estimates the push it did not command, and the swarm averages the estimates."""

from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf


class Trim(mf.Controller):
    name = "trim"
    parameters = 2  # the model: what the air adds to every acceleration, along x and y, m/s²
    diagnostics = ("push_m_s2",)

    class Options(mf.Options, frozen=True):
        stiffness: Annotated[float, Meta(gt=0, description="pull, 1/s²")] = 0.02
        damping: Annotated[float, Meta(gt=0, description="1/s")] = 0.3
        rate: Annotated[float, Meta(gt=0, le=1, description="step size of the learner, 1")] = 0.05

    def init(self, uavs, plan):
        nothing = np.zeros((len(uavs), 2))
        return {"push": nothing, "velocity": plan[uavs, 2:], "commanded": nothing}

    def step(self, memory, tick, own, received):
        push = memory["push"]
        if tick:
            felt = (own[:, 2:] - memory["velocity"]) / self.scenario.dt - memory["commanded"]
            push = push + self.options.rate * (felt - push)
        acceleration = -self.options.stiffness * own[:, :2] - self.options.damping * own[:, 2:] - push
        after = {"push": push, "velocity": own[:, 2:], "commanded": acceleration}
        return mf.Step(after, acceleration, np.linalg.norm(push, axis=1, keepdims=True))

    def get(self, memory):
        return memory["push"]

    def set(self, memory, rows, models):
        push = memory["push"].copy()
        push[rows] = models
        return {**memory, "push": push}
