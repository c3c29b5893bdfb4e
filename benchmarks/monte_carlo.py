"""Time of a flight of the paper's grid, and of the whole grid."""

import time
from collections import Counter

from benchmarks.figure import Effort, Figure, Outcome, Say, per_call_ms
from benchmarks.in_process import learner_step
from meanflock.swarm import scenario
from research.reproduction.experiments import to_do
from research.reproduction.flight import fly
from research.reproduction.grid import wanted

TITLE = "Many flights"
ABOUT = (
    "Flights as `paper` flies them, one a task: the engine of `--in-process` with nobody listening, take-off and the "
    "record of the grid included. The floor is the learner's step alone on as many rows. The time of the grid is "
    "estimated: a flight of each method and size, with all else as in the paper's scenario, times how many of them "
    "`meanflock paper --seeds 30` flies, on two cores."
)
SEEDS, CORES = 30, 2
TARGET_MINUTES = 90.0
SHOWN = ("mfgfl-hf", "hjb")
SHOWN_UAVS = 25


def run(effort: Effort, say: Say) -> Outcome:
    """Every kind of flight in the grid, in turns."""
    counts: Counter[tuple[str, int]] = Counter()
    for wish in to_do(wanted(SEEDS), {}):
        for flown in filter(None, (wish.training, wish.scenario)):
            counts[str(flown.method), flown.uavs] += 1
    whole = max(wish.scenario.max_ticks for wish in wanted(1))
    ticks = effort.choose(whole, whole // 30)
    us: dict[tuple[str, int], list[float]] = {kind: [] for kind in counts}
    steps: dict[str, list[float]] = {method: [] for method in SHOWN}
    for repeat in range(effort.choose(3, 1)):
        for method, uavs in counts:
            say(f"{method}, {uavs} UAVs, {repeat + 1}")
            us[method, uavs].append(_us_a_tick(method, uavs, ticks))
        for method in SHOWN:
            steps[method].append(per_call_ms(learner_step(method, SHOWN_UAVS), 200) * 1e3)
    minutes = [
        sum(count * us[kind][k] for kind, count in counts.items()) * whole * 1e-6 / 60.0 / CORES
        for k in range(len(us["hjb", SHOWN_UAVS]))
    ]
    outcome = Outcome(
        [Figure(f"grid of {SEEDS} seeds, {CORES} cores, estimated", "min", minutes, target=TARGET_MINUTES)]
    )
    for method in SHOWN:
        floor = Figure(f"learner step alone, {method}, {SHOWN_UAVS} rows", "µs", steps[method])
        mine = us[method, SHOWN_UAVS]
        outcome.figures += [Figure(f"flight, {method}, {SHOWN_UAVS} UAVs", "µs/tick", mine, floor=floor), floor]
    outcome.notes.append(f"The grid is {sum(counts.values())} flights of {whole} ticks, each flown once.")
    return outcome


def _us_a_tick(method: str, uavs: int, ticks: int) -> float:
    flown = scenario.load(None, [f"duration={ticks / 10}"], method=method, uavs=uavs, stop="duration")
    start = time.perf_counter()
    fly(flown)
    return (time.perf_counter() - start) / ticks * 1e6
