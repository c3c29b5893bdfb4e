"""A neural network that UAVs train in flight: handwritten digits, of which each UAV has seen two kinds.

Every UAV holds pictures of two of the ten digits (scikit-learn's, nothing is downloaded) and trains a network of
64-32-10 units, 2,410 weights. Run as a program, this file flies it alone, with a leader, with neighbours and on a bad
radio, and compares the accuracy on pictures that no UAV has trained on. It needs `pip install scikit-learn` besides
meanflock[ground]; a checkout that has run `make test` has both.
"""

import argparse
import json
import sys
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

import meanflock as mf

SHAPES = ((64, 32), (1, 32), (32, 10), (1, 10))  # weights and offsets of two layers
SIZES = tuple(rows * columns for rows, columns in SHAPES)
WAYS: dict[str, tuple[str, dict[str, Any]]] = {  # how to fly it: mission and settings
    "alone": ("paper", {"controller.share": False}),
    "leader": ("paper", {"federation.fraction": 1.0}),
    "neighbours": ("paper", {"federation.fraction": 1.0, "federation.topology": "neighbours"}),
    "lossy, leader": ("lossy", {"federation.fraction": 1.0}),
    "lossy, neighbours": ("lossy", {"federation.fraction": 1.0, "federation.topology": "neighbours"}),
}


@cache
def pictures() -> tuple[np.ndarray, np.ndarray]:
    """Brightness (1797, 64) in 0 … 1, and the digits (1797,). Every fifth picture is for tests."""
    package = find_spec("sklearn")  # its file is read without loading the package, which takes a process seconds
    if package is None or package.origin is None:
        raise ModuleNotFoundError("the digits are scikit-learn's; pip install scikit-learn")
    table = np.loadtxt(Path(package.origin).parent / "datasets" / "data" / "digits.csv.gz", delimiter=",")
    return table[:, :64] / 16.0, table[:, 64].astype(np.intp)


@cache
def training(uav: int, uavs: int) -> np.ndarray:
    """Numbers of the pictures that a UAV trains on: of two digits, shared among all UAVs that have them."""
    digits = pictures()[1]
    kinds = [(k % 10, (k + 1 + k // 10) % 10) for k in range(uavs)]
    found = []
    for kind in kinds[uav]:
        numbers = np.flatnonzero((digits == kind) & (np.arange(len(digits)) % 5 > 0))
        holders = [k for k in range(uavs) if kind in kinds[k]]
        found.append(numbers[holders.index(uav) :: len(holders)])
    return np.concatenate(found)


def layers(models: np.ndarray) -> list[np.ndarray]:
    """The matrices (M, rows, columns) of models (M, 2410)."""
    parts = np.split(models, np.cumsum(SIZES)[:-1], axis=1)
    return [part.reshape(-1, *shape) for part, shape in zip(parts, SHAPES, strict=True)]


def forward(models: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hidden units and outputs of models (M, 2410) for inputs (M, B, 64). A product of matrices for each model: rows of
    a product that all models share would depend on their number, in the last bit."""
    first, first_offset, second, second_offset = layers(models)
    hidden = np.tanh(inputs @ first + first_offset)
    return hidden, hidden @ second + second_offset


def gradient(models: np.ndarray, inputs: np.ndarray, digits: np.ndarray) -> np.ndarray:
    """Gradient (M, 2410) of the cross-entropy, for inputs (M, B, 64) and digits (M, B)."""
    hidden, outputs = forward(models, inputs)
    error = np.exp(outputs - outputs.max(axis=2, keepdims=True))
    error = (error / error.sum(axis=2, keepdims=True) - np.eye(10)[digits]) / digits.shape[1]
    back = (error @ layers(models)[2].swapaxes(1, 2)) * (1.0 - hidden**2)
    parts = (inputs.swapaxes(1, 2) @ back, back.sum(axis=1), hidden.swapaxes(1, 2) @ error, error.sum(axis=1))
    return np.concatenate([part.reshape(len(models), -1) for part in parts], axis=1)


class Classifier(mf.Controller):
    """SGD in the last ticks before each round, a step a tick: what is learned later the global model overwrites."""

    name = "classifier"
    parts = SIZES
    weights = sum(SIZES)
    diagnostics = ("accuracy",)
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        share: Annotated[bool, Meta(description="take part in rounds")] = True
        steps: Annotated[int, Meta(ge=1, description="steps of SGD before each round")] = 10
        batch: Annotated[int, Meta(ge=1, description="pictures of a step")] = 32
        rate: Annotated[float, Meta(gt=0, description="learning rate, 1")] = 0.3
        by_samples: Annotated[bool, Meta(description="weigh each model by the number of its pictures")] = False

    def __init__(self, options: Any, scenario: mf.Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters, self.parts = (sum(SIZES), SIZES) if options.share else (0, ())
        self.weighted = options.by_samples

    def init(self, uavs, plan):
        draw = np.random.default_rng(self.scenario.seed)  # all begin with the same model
        scales = np.repeat([np.sqrt(2.0 / rows) if rows > 1 else 0.0 for rows, _ in SHAPES], SIZES)
        model = scales * draw.standard_normal(sum(SIZES))
        return {"uav": uavs, "model": np.tile(model, (len(uavs), 1)), "accuracy": np.zeros(len(uavs))}

    def step(self, memory, tick, own, received):
        acceleration = -0.02 * own[:, :2] - 0.3 * own[:, 2:]
        model = memory["model"]
        accuracy = memory["accuracy"]
        since = tick % self.scenario.period_ticks
        begins = self.scenario.period_ticks - self.options.steps
        if since == begins:  # the global model has come; training begins
            brightness, digits = (each[::5] for each in pictures())
            outputs = forward(model, np.broadcast_to(brightness, (len(model), *brightness.shape)))[1]
            accuracy = (outputs.argmax(axis=2) == digits).mean(axis=1)
        if since >= begins and len(own):
            batch = np.stack([self.batch(int(uav), tick) for uav in memory["uav"]])
            model = model - self.options.rate * gradient(model, *(each[batch] for each in pictures()))
        return mf.Step({**memory, "model": model, "accuracy": accuracy}, acceleration, accuracy[:, None])

    def batch(self, uav: int, tick: int) -> np.ndarray:
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


def fly(way: str, given: argparse.Namespace, say: Any) -> list[dict[str, float]]:
    """A flight; after each round the test accuracy of the UAVs' models, mean and least, and the bits sent so far."""
    mission, settings = WAYS[way]
    duration = (given.rounds + 1) * Classifier.period_ticks * mf.Scenario.load(mission).dt
    settings = {"stop": "duration", "duration": duration, **settings, **dict(given.set)}
    told = {"progress": lambda tick, ticks: say(f"{way}: {100 * tick // ticks} %")}
    run = mf.fly(mission, method=Classifier, uavs=given.uavs, seed=given.seed, **told, **settings)
    rows = run.frame().to_pylist()[Classifier.period_ticks :: Classifier.period_ticks]  # before the next global model
    bits = [sum(row[f"{kind}_bits"] for kind in ("uplink", "relay", "broadcast")) for row in rows]
    known = [np.array(row["accuracy"]) for row in rows]
    return [
        {"round": number, "accuracy": float(each.mean()), "accuracy_min": float(each.min()), "bits": bits[number]}
        for number, each in enumerate(known[: given.rounds + 1])
    ]


def table(flown: dict[str, list[dict[str, float]]]) -> str:
    """Test accuracy, mean of the UAVs, and bits so far in Mbit, every five rounds, in Markdown."""
    lines = [["round", *flown], ["---"] * (len(flown) + 1)]
    for rows in list(zip(*flown.values(), strict=True))[::5]:
        cells = [f"{100 * row['accuracy']:.1f} %, {row['bits'] / 1e6:.2f}" for row in rows]
        lines.append([str(rows[0]["round"]), *cells])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def picture(flown: dict[str, list[dict[str, float]]], path: Path) -> None:
    """Accuracy over rounds, and over bits."""
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(11, 4.2), sharey=True, layout="constrained")
    for way, dashes in zip(flown, (":", "-", "--", "-.", (0, (1, 1))), strict=False):
        accuracy = [100 * row["accuracy"] for row in flown[way]]
        for panel, x, unit in zip(panels, ("round", "bits"), (1, 1e6), strict=True):
            panel.plot([row[x] / unit for row in flown[way]], accuracy, linestyle=dashes, linewidth=2, label=way)
    panels[0].set(xlabel="round", ylabel="test accuracy, mean of the UAVs, %", ylim=(0, 100))
    panels[1].set(xlabel="bits of models sent so far, Mbit")
    panels[0].legend(loc="center right")
    figure.savefig(path, dpi=130)


def setting(text: str) -> tuple[str, Any]:
    """The key and the value of KEY=VALUE: a number, true or false, or else a text."""
    key, value = text.split("=", 1)
    with suppress(ValueError):
        value = json.loads(value)
    return key, value


def main() -> int:
    """The exit code: 0, 2 for bad input, 130 when interrupted. What is finished is written in any case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--uavs", type=int, default=10, help="number of UAVs")
    parser.add_argument("--rounds", type=int, default=40, help="number of rounds")
    parser.add_argument("--seed", type=int, default=1, help="seed")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS), metavar="WAY", help="all, or some")
    parser.add_argument("--set", nargs="+", type=setting, default=[], metavar="KEY=VALUE", help="keys of all scenarios")
    parser.add_argument("--out", type=Path, default=Path("out/classifier"), help="folder to write")
    given = parser.parse_args()
    flown, code = {}, 0
    try:
        for way in given.ways:
            flown[way] = fly(way, given, lambda text: print(f"{text:40}\r", end="", file=sys.stderr, flush=True))
    except (KeyboardInterrupt, mf.BadInput) as error:
        code = 2 if isinstance(error, mf.BadInput) else 130
        print(f"error: {error}" if code == 2 else "interrupted", file=sys.stderr)
    if flown:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "classifier.json").write_text(json.dumps(flown, indent=1) + "\n", encoding="utf-8")
        (given.out / "classifier.md").write_text(table(flown), encoding="utf-8")
        picture(flown, given.out / "classifier.png")
        print(table(flown), end="")
    return code


if __name__ == "__main__":
    sys.exit(main())
