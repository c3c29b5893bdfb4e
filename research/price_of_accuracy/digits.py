"""Learner of handwritten digits in NumPy: net, data and training of examples/flower_app, for flights without Flower.

A net of 64-32-10 units, 2,410 floats, as in examples/digits.py; each UAV has seen two digits of ten.
"""

import runpy
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

import meanflock as mf

TASK = runpy.run_path(
    str(Path(__file__).resolve().parents[2] / "examples" / "flower_app" / "flower_digits" / "task.py")
)


class Digits(mf.Learner):
    """One pass of SGD over the pictures of a UAV; accuracy is of the global model, on pictures nobody trains on."""

    name = "digits-numpy"
    metrics = ("loss", "accuracy")
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        rate: Annotated[float, Meta(gt=0, description="learning rate, 1")] = 0.3

    @classmethod
    def initial(cls, options: Any, scenario: mf.Scenario) -> mf.Tree:
        """See `Learner.initial`."""
        model: mf.Tree = TASK["new_model"](scenario.seed)
        return model

    def fit(self, model: mf.Tree, config: mf.Fit) -> mf.Trained:
        """See `Learner.fit`."""
        data = TASK["train_data"](self.uav, self.scenario.uavs)
        loss = TASK["train"](model, data, 1, self.options.rate, config.seed)
        return mf.Trained(model, len(data[1]), {"loss": loss})

    def evaluate(self, model: mf.Tree, config: mf.Fit) -> dict[str, float]:
        """See `Learner.evaluate`."""
        return {"accuracy": TASK["test"](model, TASK["test_data"]())[1]}
