"""A controller in a file: every UAV is pulled to the destination by a damped spring, and keeps off its neighbours."""

from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf


class Spring(mf.Controller):
    name = "spring"

    class Options(mf.Options, frozen=True):
        stiffness: Annotated[float, Meta(gt=0, description="pull, 1/s²")] = 0.02
        damping: Annotated[float, Meta(gt=0, description="1/s")] = 0.3

    def step(self, memory, tick, own, received):
        acceleration = -self.options.stiffness * own[:, :2] - self.options.damping * own[:, 2:]
        for frames in received:  # from everyone in range whom the radio delivered
            sent, row = frames.links.T
            apart = own[row, :2] - frames.payload[sent, :2]
            np.add.at(acceleration, row, apart / (1.0 + (apart**2).sum(axis=1, keepdims=True)) ** 2)
        return mf.Step(memory, acceleration, broadcasts=[mf.Broadcast(own)])
