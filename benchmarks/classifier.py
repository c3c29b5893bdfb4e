"""The classifier of the examples against Flower: same training and averaging, same global model."""

import importlib.util
import multiprocessing
import tempfile
import time
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import psutil
from meanflock.launch.engine import Engine

from benchmarks.figure import Effort, Figure, Outcome, Say
from benchmarks.machine import ROOT
from benchmarks.peer.environment import Environment, Peer
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

TITLE = "A classifier against Flower"
ABOUT = (
    "`examples/classifier.py`, 2,410 weights, 10 UAVs that hold two digits each, 20 rounds with all of them over a "
    "radio that loses nothing; and the same batches, rate and first model in Flower's simulation engine (FedAvg, one "
    "worker for each core), its clients written anew in NumPy. *Difference* is the largest of any weight of the global "
    "models after the last round; Flower adds floats up in the order of arrival. Our round also flies 20 ticks."
)
UAVS = 10
ROUNDS = 20
STEPS = 10
BATCH = 32
BOUNDS = {64: 1e-12, 32: 1e-6}  # of the difference, by bits of a float
KEYS = ("first", "first_offset", "second", "second_offset")


class Flown(NamedTuple):
    """Our flight: the global model (L,), ms a round, and resident memory of the process, MiB."""

    model: Floats
    ms: float
    memory_mib: float


def run(effort: Effort, say: Say) -> Outcome:
    """Each width of floats and way of weighing; times and memory of the first."""
    outcome = Outcome()
    for bits, weighted in product(BOUNDS, (False, True)):
        case = f"{bits} bits{', by samples' if weighted else ''}"
        with tempfile.TemporaryDirectory(prefix="classifier-") as folder:
            write_task(Path(folder), bits, weighted)
            say(f"Flower, {case}")
            with Environment("flwr").start("flwr_classifier", UAVS, folder) as peer:
                theirs, ours = [], []
                for repeat in range(1 if outcome.figures else effort.choose(5, 2)):
                    theirs.append(peer.measure(1) / ROUNDS)
                    say(f"ours, {case}, {repeat + 1}")
                    ours.append(fly_apart(bits, weighted))
                memory = memory_mib(peer)
            model = np.load(Path(folder) / "global.npy")
        if not outcome.figures:
            floor = Figure(f"{peer.version}: round", "ms", theirs, "neither")
            room = Figure(f"{peer.version}: memory of all its processes", "MiB", [memory], "neither")
            mine = Figure("our memory", "MiB", [flown.memory_mib for flown in ours], floor=room)
            outcome.figures = [Figure("our round", "ms", [one.ms for one in ours], floor=floor), floor, mine, room]
        difference = [float(np.abs(flown.model - model).max()) for flown in ours]
        outcome.figures.append(Figure(f"difference, {case}", "1", difference, target=BOUNDS[bits]))
    return outcome


def example() -> ModuleType:
    """The file of the example, imported."""
    spec = importlib.util.spec_from_file_location("classifier", ROOT / "examples" / "classifier.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def scenario(classifier: ModuleType, bits: int, weighted: bool) -> Scenario:
    """The scenario of the flight."""
    return Scenario(
        method=classifier.Classifier,
        uavs=UAVS,
        stop="duration",
        controller={"steps": STEPS, "batch": BATCH, "by_samples": weighted},
        duration=1e4,
        radio={"model": "ideal", "bits_per_float": bits},
        federation={"fraction": 1.0},
    )


def write_task(folder: Path, bits: int, weighted: bool) -> None:
    """Write pictures, batches and first model to files, for the other program."""
    classifier = example()
    flown = scenario(classifier, bits, weighted)
    learner = classifier.Classifier(classifier.Classifier.Options(**flown.controller), flown)
    inputs, labels = classifier.pictures()
    memory = learner.init(np.arange(UAVS), np.zeros((UAVS, 4)))
    layers = [part for layer in classifier.layers(memory["model"]) for part in (layer[0, :-1], layer[0, -1:])]
    first = dict(zip(KEYS, layers, strict=True))
    ticks = [number * flown.period_ticks - STEPS + step for number in range(1, ROUNDS + 1) for step in range(STEPS)]
    samples = learner.samples(memory).astype(int) if weighted else np.ones(UAVS, dtype=int)
    batches = np.array([[learner.batch(uav, tick) for uav in range(UAVS)] for tick in ticks], dtype=np.uint16)
    arrays = {name: layer.astype(f"f{bits // 8}") for name, layer in first.items()}
    arrays |= {"inputs": inputs[:, :-1], "labels": labels, "samples": samples}
    arrays |= {"batches": batches.reshape(ROUNDS, STEPS, UAVS, BATCH), "rate": np.array(learner.options.rate)}
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)


def fly(bits: int, weighted: bool) -> Flown:
    """Fly our rounds in this process."""
    classifier = example()
    flown = scenario(classifier, bits, weighted)
    engine = Engine(flown, "benchmark")
    ticks, last = engine.fly(), (ROUNDS + 1) * flown.period_ticks - STEPS  # the last global model is in place
    start = time.perf_counter()
    while next(ticks) < last:
        pass
    ms = (time.perf_counter() - start) / ROUNDS * 1e3
    return Flown(engine.models[0], ms, psutil.Process().memory_info().rss / 2**20)


def fly_apart(bits: int, weighted: bool) -> Flown:
    """Fly our rounds in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(fly, (bits, weighted))


def memory_mib(peer: Peer) -> float:
    """Resident memory of a peer and of all processes that it started."""
    process = psutil.Process(peer.pid)
    return sum(one.memory_info().rss for one in (process, *process.children(recursive=True))) / 2**20
