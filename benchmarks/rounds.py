"""Rounds that a leader or neighbours average, and rounds of long models."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import meanflock as mf
from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms, per_tick_ms
from benchmarks.processes import Children
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.net.networked import NetworkedRun
from meanflock.net.session import ZenohBus
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.world import REPORT_EVERY_TICKS

TITLE = "Long models, and rounds without a leader"
ABOUT = (
    "A model of 100,000 floats goes in 432 fragments over the default radio; all 25 UAVs of one process upload it, and "
    "get the average. The five ticks from the uploads to the models in place, the channel's draws included, beside "
    "adding up 25 such arrays in NumPy. Below, mfgfl-hf: the three ticks of a round with the topology `neighbours` "
    "beside those with a leader, 25 processes each, in turns; and the same of 320 UAVs in one process. Ticks of "
    "reports are left out."
)
UAVS, MANY = 25, 320
PERIOD = 25
FLOATS, LONG_TICKS, ROUND_TICKS = 100_000, 5, 3
LONG_RATIO, NEIGHBOURS_RATIO, MANY_MS = 35.0, 2.0, 500.0


class Long(mf.Controller):
    """Flies straight at the goal; shares 100,000 floats that nobody reads."""

    name = "long"
    parameters = FLOATS

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.weights = 0  # none of them is reported

    def init(self, uavs: np.ndarray, initial_states: np.ndarray) -> dict[str, Any]:
        return {"model": uavs[:, None] + np.linspace(0.0, 1.0, FLOATS)}

    def step(self, memory: dict[str, Any], tick: int, own: np.ndarray, received: Any) -> mf.Step:
        return mf.Step(memory, -0.02 * own[:, :2] - 0.3 * own[:, 2:])

    def get(self, memory: dict[str, Any]) -> np.ndarray:
        model: np.ndarray = memory["model"]
        return model

    def set(self, memory: dict[str, Any], rows: np.ndarray, models: np.ndarray) -> dict[str, Any]:
        model = memory["model"].copy()
        model[rows] = models
        return {**memory, "model": model}


def run(effort: Effort, say: Say) -> Outcome:
    """Long models, then both topologies on processes, then many neighbours in one process."""
    return Outcome([*_long(effort, say), *_networked(effort, say), *_many(effort, say)])


def _long(effort: Effort, say: Say) -> list[Figure]:
    say("long models: take-off")
    ticks = Engine(_scenario("leader", UAVS, Long), "benchmark").fly()
    arrays = [np.random.default_rng(uav).standard_normal(FLOATS) for uav in range(UAVS)]

    def add_up() -> None:
        total = np.zeros(FLOATS)
        for array in arrays:
            total += array

    _reach_a_round(ticks)
    say("long models, in turns with NumPy")
    measures = {"round": lambda: _round_ms(ticks, LONG_TICKS), "floor": lambda: per_call_ms(add_up, 5)}
    ms = in_turns(effort.choose(20, 3), measures)
    floor = Figure(f"adding up {UAVS} arrays of {FLOATS:,} floats", "ms", ms["floor"])
    return [Figure("a round of such models", "ms", ms["round"], floor=floor, ratio_target=LONG_RATIO), floor]


def _networked(effort: Effort, say: Say) -> list[Figure]:
    say(f"starting {2 * UAVS + 1} processes")
    with _flying("leader") as leader, _flying("neighbours") as neighbours:
        for ticks in (leader, neighbours):
            _reach_a_round(ticks)
        say("rounds of both topologies in turns")
        measures = {
            "leader": lambda: _round_ms(leader, ROUND_TICKS),
            "neighbours": lambda: _round_ms(neighbours, ROUND_TICKS),
        }
        ms = in_turns(effort.choose(12, 3), measures)
    floor = Figure(f"a leader's round, {UAVS} processes", "ms", ms["leader"])
    mine = Figure(
        f"a neighbours' round, {UAVS} processes", "ms", ms["neighbours"], floor=floor, ratio_target=NEIGHBOURS_RATIO
    )
    return [mine, floor]


def _many(effort: Effort, say: Say) -> list[Figure]:
    say(f"{MANY} neighbours in one process")
    ticks = Engine(_scenario("neighbours", MANY, "mfgfl-hf"), "benchmark").fly()
    _reach_a_round(ticks)
    ms = [_round_ms(ticks, ROUND_TICKS) for _ in range(effort.choose(5, 2))]
    return [Figure(f"a neighbours' round, {MANY} UAVs in one process", "ms", ms, target=MANY_MS)]


def _scenario(topology: str, uavs: int, method: Any) -> Scenario:
    federation = {"topology": topology, "period": PERIOD, "fraction": 1.0}
    return Scenario(method=method, uavs=uavs, stop="duration", duration=1e6, federation=federation)


@contextmanager
def _flying(topology: str) -> Iterator[Iterator[int]]:
    """The ticks of a swarm of processes."""
    flown = _scenario(topology, UAVS, "mfgfl-hf")
    with Children(f"rounds-{topology}") as swarm:
        bus = ZenohBus.router(swarm.endpoint)
        try:
            world = NetworkedRun(flown, bus, swarm.run)
            if plan_of(flown).leaders():
                swarm.start("meanflock.leader")
            swarm.start("meanflock.agent", "--count", str(UAVS))
            world.gather(60.0)
            yield world.fly()
            world.nodes.stop("measured")
            swarm.wait(3.0)
        finally:
            bus.close()


def _reach_a_round(ticks: Iterator[int]) -> None:
    """Flies until a round is next that shares no tick with a report."""
    per_tick_ms(ticks, 3 * PERIOD)
    assert all((3 * PERIOD + tick) % REPORT_EVERY_TICKS for tick in range(LONG_TICKS))


def _round_ms(ticks: Iterator[int], length: int) -> float:
    """The ticks of the next round, ms; flies on to the next but one, because the next meets a report."""
    times = [per_tick_ms(ticks, 1) for _ in range(2 * PERIOD)]
    return sum(times[:length])
