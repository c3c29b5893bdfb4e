"""A learner in NumPy for tests: each UAV fits a line to points of its own."""

from typing import Any

import numpy as np

import meanflock as mf
from meanflock.swarm import plugins


class Line(mf.Learner):
    """Stochastic gradient descent on a line through 20 points."""

    name = "line"
    metrics = ("loss",)
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        rate: float = 0.05

    def __init__(self, options: Any, scenario: mf.Scenario, uav: int) -> None:
        super().__init__(options, scenario, uav)
        draw = mf.seeds.generator(scenario.seed, "controller", uav)
        self.inputs = draw.normal(size=(20, 3))
        self.outputs = self.inputs[:, 0] - 2.0 * self.inputs[:, 1] + 0.1 * draw.normal(size=20)

    @classmethod
    def initial(cls, options: Any, scenario: mf.Scenario) -> mf.Tree:
        return {"weights": np.zeros(3, np.float32), "steps": np.zeros((), np.int64)}

    def fit(self, model: Any, config: mf.Fit) -> mf.Trained | None:
        weights = model["weights"].astype(np.float64)
        for k in np.random.permutation(20):  # noqa: NPY002  # the generators are seeded
            weights -= self.options.rate * ((self.inputs[k] * weights).sum() - self.outputs[k]) * self.inputs[k]
        loss = float((((self.inputs * weights).sum(axis=1) - self.outputs) ** 2).mean())
        trained = {"weights": weights.astype(np.float32), "steps": model["steps"] + np.int64(1)}
        return mf.Trained(trained, 20.0, {"loss": loss})


FLOWN: dict[str, Any] = {  # a round every 2 s
    "method": "plan",
    "uavs": 4,
    "duration": 10.0,
    "federation.fraction": 1.0,
    "stop": "duration",
}


def fly(learner: type[mf.Learner] = Line, **settings: Any) -> "mf.Run":  # an agent lacks PyArrow
    """A flight of four UAVs, which registers the learner."""
    return mf.fly("paper", learner=learner, **(FLOWN | settings))


def scenario(learner: type[mf.Learner] = Line, **settings: Any) -> mf.Scenario:
    """The scenario of such a flight, with the class registered."""
    plugins.register(learner)
    return mf.Scenario(**(FLOWN | {"training.learner": learner.name} | settings))
