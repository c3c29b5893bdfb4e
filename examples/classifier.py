"""A neural network that UAVs train in flight: handwritten digits, of which each UAV has seen two kinds.

Every UAV trains a network of 64-32-10 units, 2,410 weights, which go in fragments. Run as a program, this file flies it
alone, with a leader, with neighbours and on a bad radio, and compares the accuracy on pictures that no UAV has trained
on. It needs `pip install scikit-learn`, which has the digits, besides meanflock[ground].
"""

import argparse
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf

WAYS = {  # how to fly it: mission and settings
    "alone": ("paper", {"controller.share": False}),
    "leader": ("paper", {}),
    "neighbours": ("paper", {"federation.topology": "neighbours"}),
    "lossy, leader": ("lossy", {}),
    "lossy, neighbours": ("lossy", {"federation.topology": "neighbours"}),
}


@cache
def pictures():
    """Brightness in 0 … 1 with a 1 behind, (1797, 65), and the digits (1797,). Every fifth picture is for tests."""
    package = Path(find_spec("sklearn").origin).parent  # found, but not loaded: that takes a process seconds
    table = np.loadtxt(package / "datasets" / "data" / "digits.csv.gz", delimiter=",")
    return np.pad(table[:, :64] / 16.0, ((0, 0), (0, 1)), constant_values=1.0), table[:, 64].astype(np.intp)


@cache
def training(uav, uavs):
    """Numbers of the pictures that a UAV trains on: of two digits; UAVs with the same first digit share them out."""
    digits = pictures()[1]
    has_digit = np.isin(digits, (uav % 10, (uav + 1 + uav // 10) % 10))
    return np.flatnonzero(has_digit & (np.arange(len(digits)) % 5 > 0))[uav // 10 :: 1 + (uavs - 1) // 10]


def layers(models):
    """The matrices of models (M, 2410), (M, 65, 32) and (M, 33, 10); the last row of each has the offsets."""
    return models[:, : 65 * 32].reshape(-1, 65, 32), models[:, 65 * 32 :].reshape(-1, 33, 10)


def forward(models, inputs):
    """Hidden units and outputs of models (M, 2410) for inputs (M, B, 65), each model by itself: the bits of a product
    that several share would depend on their number."""
    first, second = layers(models)
    hidden = np.pad(np.tanh(inputs @ first), ((0, 0), (0, 0), (0, 1)), constant_values=1.0)
    return hidden, hidden @ second


def gradient(models, inputs, digits):
    """Gradient (M, 2410) of the cross-entropy, for inputs (M, B, 65) and digits (M, B)."""
    hidden, outputs = forward(models, inputs)
    error = np.exp(outputs - outputs.max(axis=2, keepdims=True))
    error = (error / error.sum(axis=2, keepdims=True) - np.eye(10)[digits]) / digits.shape[1]
    back = (error @ layers(models)[1].swapaxes(1, 2)) * (1.0 - hidden**2)
    parts = inputs.swapaxes(1, 2) @ back[:, :, :32], hidden.swapaxes(1, 2) @ error
    return np.concatenate([part.reshape(len(models), -1) for part in parts], axis=1)


class Classifier(mf.Controller):
    """SGD in the last ticks before each round, a step a tick: what is learned later the global model overwrites."""

    name = "classifier"
    weights = 2410
    diagnostics = ("accuracy",)
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        share: Annotated[bool, Meta(description="take part in rounds")] = True
        steps: Annotated[int, Meta(ge=1, description="steps of SGD before each round")] = 10
        batch: Annotated[int, Meta(ge=1, description="pictures of a step")] = 32
        rate: Annotated[float, Meta(gt=0, description="learning rate, 1")] = 0.3
        by_samples: Annotated[bool, Meta(description="weigh each model by the number of its pictures")] = False

    def __init__(self, options, scenario):
        super().__init__(options, scenario)
        self.parameters = self.weights if options.share else 0
        self.weighted = options.by_samples

    def init(self, uavs, plan):
        model = np.random.default_rng(self.scenario.seed).standard_normal(2410)  # all begin with the same one
        model *= np.sqrt(2.0 / np.repeat([65, 33], [65 * 32, 33 * 10]))
        return {"uav": uavs, "model": np.tile(model, (len(uavs), 1)), "accuracy": np.zeros(len(uavs))}

    def step(self, memory, tick, own, received):
        model, accuracy = memory["model"], memory["accuracy"]
        trained = tick % self.scenario.period_ticks - (self.scenario.period_ticks - self.options.steps)
        if trained == 0:  # the global model has come; training begins
            inputs, digits = (each[::5] for each in pictures())
            outputs = forward(model, np.broadcast_to(inputs, (len(model), *inputs.shape)))[1]
            accuracy = (outputs.argmax(axis=2) == digits).mean(axis=1)
        if trained >= 0 and len(own):
            batch = np.stack([self.batch(int(uav), tick) for uav in memory["uav"]])
            model = model - self.options.rate * gradient(model, *(each[batch] for each in pictures()))
        acceleration = -0.02 * own[:, :2] - 0.3 * own[:, 2:]
        return mf.Step({**memory, "model": model, "accuracy": accuracy}, acceleration, accuracy[:, None])

    def batch(self, uav, tick):
        """Numbers of the pictures of a step."""
        draw = mf.seeds.generator(self.scenario.seed, "controller", tick * self.scenario.uavs + uav)
        return draw.choice(training(uav, self.scenario.uavs), self.options.batch)

    def samples(self, memory):
        return np.array([float(len(training(int(uav), self.scenario.uavs))) for uav in memory["uav"]])

    def get(self, memory):
        return memory["model"]

    def set(self, memory, rows, models):
        model = memory["model"].copy()
        model[rows] = models
        return {**memory, "model": model}


def fly(way, uavs, rounds, seed=1):
    """After each round: the test accuracy of the UAVs' models, mean and least, and the bits of models so far."""
    mission, settings = WAYS[way]
    duration = 0.1 * Classifier.period_ticks * (rounds + 1)  # with a tick of 0.1 s
    settings = {"federation.fraction": 1.0, "stop": "duration", "duration": duration, **settings}
    rows = mf.fly(mission, method=Classifier, uavs=uavs, seed=seed, **settings).frame().to_pylist()
    rows = rows[Classifier.period_ticks :: Classifier.period_ticks][: rounds + 1]  # each before the next global model
    bits = [sum(row[f"{kind}_bits"] for kind in ("uplink", "relay", "broadcast")) for row in rows]
    return [(np.mean(row["accuracy"]), min(row["accuracy"]), sent) for row, sent in zip(rows, bits, strict=True)]


def picture(flown, folder):
    """Accuracy over rounds, and over bits: accuracy.png."""
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(11, 4.2), sharey=True, layout="constrained")
    for way, rows in flown.items():
        accuracy, _, bits = np.array(rows).T
        panels[0].plot(100 * accuracy, label=way)
        panels[1].plot(bits / 1e6, 100 * accuracy)
    panels[0].set(xlabel="round", ylabel="test accuracy, mean of the UAVs, %", ylim=(0, 100))
    panels[1].set(xlabel="bits of models sent so far, Mbit")
    panels[0].legend(loc="center right")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "accuracy.png", dpi=130)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--uavs", type=int, default=10, help="number of UAVs")
    parser.add_argument("--rounds", type=int, default=40, help="number of rounds")
    given, flown = parser.parse_args(), {}
    for way in WAYS:
        flown[way] = fly(way, given.uavs, given.rounds)
        accuracy, least, bits = flown[way][-1]
        print(f"{way}: {accuracy:.1%} of the tests, {least:.1%} by the worst UAV, {bits / 1e6:.1f} Mbit", flush=True)
    picture(flown, Path("out/classifier"))


if __name__ == "__main__":
    main()
