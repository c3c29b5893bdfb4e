"""All rooms in one process: the engine of tests and sweeps."""

from collections.abc import Callable
from types import ModuleType

import numpy as np

from benchmarks.bare_numpy import learner_operations
from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms, per_tick_ms
from meanflock import kernels
from meanflock.agent.controllers.mean_field.learner import MeanFieldLearner, tables
from meanflock.kernels import reference
from meanflock.kernels.mean_field.layout import NUMBERS
from meanflock.launch.engine import Engine
from meanflock.swarm import mission, scenario, state
from meanflock.swarm.scenario import Scenario

TITLE = "The swarm in one process"
ABOUT = (
    "25 UAVs as rows of one agent in the world's process: learning, radio, metering and rounds as in the swarm of "
    "processes, without codec and bus. Floors: the learner's step alone, compiled and in NumPy; "
    "the bare array operations of the latter on buffers made beforehand; and those on a single row, which is what so "
    "many NumPy calls cost."
)
UAVS = 25
TARGET_MS, STRETCH_MS = 1.0, 0.49  # 100 × real time; crazyflow's physics alone, 25 drones, on a CPU
CHUNK = 50


def flight(method: str, uavs: int) -> Engine:
    """An engine that flies as long as it is asked to."""
    flown = scenario.load(None, method=method, uavs=uavs, stop="duration", duration=1e6)
    return Engine(flown, "benchmark")


def learner_step(method: str, uavs: int, backend: ModuleType = kernels) -> Callable[[], object]:
    """One step of the learner on so many rows, from the same weights every time."""
    flown: Scenario = scenario.load(None, method=method, uavs=uavs)
    plan = mission.starts(flown)
    weights = MeanFieldLearner(flown, learns_density=method != "hjb").init(uavs, plan)
    prepared = backend.prepare(tables(flown))
    states = plan.copy()
    state.velocity(states)[...] = np.array(flown.wind.mean)
    known = np.repeat(plan[None], uavs, axis=0) if method == "hjb" else None
    stepped, numbers = np.empty_like(weights), np.empty((uavs, NUMBERS))
    return lambda: backend.learn(prepared, states, weights, known, stepped, numbers)


def run(effort: Effort, say: Say) -> Outcome:
    """mfgfl-hf and hjb, in turns with the floors."""
    say("take-off")
    flights = {method: flight(method, UAVS).fly() for method in ("mfgfl-hf", "hjb")}
    steps = {method: learner_step(method, UAVS) for method in flights}
    in_numpy = learner_step("mfgfl-hf", UAVS, reference)
    bare, calls = learner_operations(UAVS), learner_operations(1)
    for ticks in flights.values():
        per_tick_ms(ticks, CHUNK)
    say("in turns")
    ms = in_turns(
        effort.choose(40, 6),
        {
            "hf": lambda: per_tick_ms(flights["mfgfl-hf"], CHUNK),
            "hjb": lambda: per_tick_ms(flights["hjb"], CHUNK),
            "learner hf": lambda: per_call_ms(steps["mfgfl-hf"], CHUNK),
            "learner hjb": lambda: per_call_ms(steps["hjb"], CHUNK),
            "numpy hf": lambda: per_call_ms(in_numpy, CHUNK),
            "bare": lambda: per_call_ms(bare, CHUNK),
            "calls": lambda: per_call_ms(calls, CHUNK),
        },
    )
    bare_floor = Figure("bare array operations, 25 rows", "ms", ms["bare"])
    learner_hf = Figure("learner step alone, mfgfl-hf, 25 rows", "ms", ms["learner hf"])
    learner_hjb = Figure("learner step alone, hjb, 25 rows", "ms", ms["learner hjb"])
    bounds = {"target": TARGET_MS, "stretch": STRETCH_MS}
    return Outcome(
        [
            Figure("tick, mfgfl-hf", "ms/tick", ms["hf"], floor=learner_hf, **bounds),
            Figure("tick, hjb", "ms/tick", ms["hjb"], floor=learner_hjb, **bounds),
            learner_hf,
            learner_hjb,
            Figure("the same step in NumPy, mfgfl-hf, 25 rows", "ms", ms["numpy hf"], floor=bare_floor),
            bare_floor,
            Figure("the same calls on one row", "ms", ms["calls"]),
            Figure("real-time factor, mfgfl-hf", "×", [100.0 / t for t in ms["hf"]], "higher", target=100.0),
            Figure("real-time factor, hjb", "×", [100.0 / t for t in ms["hjb"]], "higher", target=100.0),
        ],
        [
            "hjb learns less than mfgfl-hf but every UAV broadcasts its state every tick: 600 links to draw, meter and "
            "deliver where mfgfl-hf has none between its rounds."
        ],
    )
