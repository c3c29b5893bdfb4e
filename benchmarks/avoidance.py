"""Collision avoidance: a tick with the filter and without it, and ORCA with a hundred UAVs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType

import numpy as np

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms, per_tick_ms
from meanflock import kernels
from meanflock.kernels import reference
from meanflock.launch.engine import Engine
from meanflock.swarm import declared, mission, scenario, state
from meanflock.swarm.scenario import Scenario

TITLE = "Keeping apart"
ABOUT = (
    "25 UAVs as rows of one process in the paper's formation at cruise speed, everyone within reach of ten others. "
    "A filter's tick is one `step` of `cruise` behind `ecbf`: states received, predicted, half-planes, the nearest "
    "acceleration in them, events. Its floor is the same `step` of `cruise` alone. Below, whole flights: world, radio "
    "and codec included."
)
UAVS, MANY = 25, 100
COMPILED_MS = 0.5
NUMPY_MS = 3.0
REAL_TIME = 20.0
CHUNK = 50


def scene(method: str, uavs: int, kind: str = "none") -> Scenario:
    """A scenario that flies as long as it is asked to."""
    return scenario.load(None, [f"filter.kind={kind}"], method=method, uavs=uavs, stop="duration", duration=1e6)


def step(flown: Scenario, backend: ModuleType = kernels) -> Callable[[], object]:
    """One step of a scenario's controller on all rows, from the same memory every time."""
    controller, plan = declared.controller(flown), mission.starts(flown)
    memory = controller.init(np.arange(flown.uavs), plan)
    draw = np.random.default_rng(1)
    own = plan + 0.1 * draw.standard_normal(plan.shape)
    state.velocity(own)[...] -= 2.25 * np.sqrt(0.5)

    def once() -> None:
        with nearest_of(backend):
            controller.step(memory, 1, own, ())

    return once


@contextmanager
def nearest_of(backend: ModuleType) -> Iterator[None]:
    """Solve half-planes with one form of the kernels."""
    before = kernels.nearest
    kernels.nearest = backend.nearest
    try:
        yield
    finally:
        kernels.nearest = before


def run(effort: Effort, say: Say) -> Outcome:
    """Steps and flights, in turns."""
    say("take-off")
    alone, behind = scene("cruise", UAVS), scene("cruise", UAVS, "ecbf")
    steps = {"alone": step(alone), "filter": step(behind), "numpy": step(behind, reference)}
    flights = {
        name: Engine(flown, "benchmark").fly()
        for name, flown in (("cruise", alone), ("filtered", behind), ("orca", scene("orca", MANY)))
    }
    for ticks in flights.values():
        per_tick_ms(ticks, CHUNK)
    say("in turns")
    calls = {name: (lambda once=once: per_call_ms(once, CHUNK)) for name, once in steps.items()}
    flown = {f"fly {name}": (lambda ticks=ticks: per_tick_ms(ticks, CHUNK)) for name, ticks in flights.items()}
    ms = in_turns(effort.choose(20, 4), calls | flown)
    own = Figure("step of cruise alone, 25 rows", "ms", ms["alone"])
    tick = Figure("tick, cruise, 25 UAVs", "ms/tick", ms["fly cruise"])
    return Outcome(
        [
            Figure("step of cruise behind ecbf, 25 rows", "ms", ms["filter"], floor=own, target=COMPILED_MS),
            Figure("the same in NumPy", "ms", ms["numpy"], floor=own, target=NUMPY_MS),
            own,
            Figure("tick, cruise behind ecbf, 25 UAVs", "ms/tick", ms["fly filtered"], floor=tick),
            tick,
            Figure(
                "real-time factor, orca at events, 100 UAVs",
                "×",
                [100.0 / one for one in ms["fly orca"]],
                "higher",
                target=REAL_TIME,
            ),
        ],
        [],
    )
