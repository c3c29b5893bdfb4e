"""Many seeds at once: the batch engine of the paper's sweeps."""

import time
from collections.abc import Callable

from benchmarks.figure import Effort, Figure, Outcome, Say
from benchmarks.in_process import flight, learner_step
from benchmarks.processes import BenchmarkFailed
from swarm import scenario

TITLE = "Many seeds at once"
ABOUT = (
    "`groundstation.paper.batch.Batch`: seeds of one scenario (25 UAVs each) as rows of one learner, no bus, no codec, "
    "no disk. Compared with the learner's step alone on as many rows, and with flying the seeds one by one in the "
    "engine."
)
UAVS = 25
TARGET_US = 5.0  # of the method that learns most


def run(effort: Effort, say: Say) -> Outcome:
    """Batches of mfgfl-hf and hjb, in turns with the learner and the engine."""
    try:
        from groundstation.paper.batch import Batch
    except Exception as error:
        raise BenchmarkFailed(f"groundstation.paper.batch: {error}") from error
    seeds, ticks = range(1, 1 + effort.of(16, 4)), effort.of(210, 60)
    outcome = Outcome()
    for method in ("mfgfl-hf", "hjb"):
        flown = scenario.load(None, method=method, uavs=UAVS, stop="duration", duration=ticks / 10)
        engine, step = flight(method, UAVS).fly(), None
        if method != "hjb":  # of hjb, the rows of different seeds know different states
            step = learner_step(method, UAVS * len(seeds))
        us: dict[str, list[float]] = {"batch": [], "engine": [], "step": []}
        for repeat in range(effort.of(5, 2)):
            say(f"{method}, {repeat + 1}")
            batch = Batch(flown, list(seeds))
            us["batch"].append(_us(batch.fly, UAVS * len(seeds) * ticks))
            us["engine"].append(_us(lambda e=engine: [next(e) for _ in range(ticks)], UAVS * ticks))
            if step is not None:
                us["step"].append(_us(lambda s=step: [s() for _ in range(ticks)], UAVS * len(seeds) * ticks))
        one = Figure(f"engine, {method}", "µs/UAV-tick", us["engine"])
        floor = Figure(f"learner step alone, {method}, {UAVS * len(seeds)} rows", "µs/UAV", us["step"])
        name = f"batch of {len(seeds)} seeds, {method}"
        target = TARGET_US if step else None
        outcome.figures.append(Figure(name, "µs/UAV-tick", us["batch"], floor=floor if step else one, target=target))
        outcome.figures += [one, floor] if step else [one]
    return outcome


def _us(work: Callable[[], object], uav_ticks: int) -> float:
    start = time.perf_counter()
    work()
    return (time.perf_counter() - start) / uav_ticks * 1e6
