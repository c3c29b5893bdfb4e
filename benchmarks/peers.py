"""Other software (peers) at comparable work, each in an environment of its own; `make peers` sets them up.

None is a dependency of meanflock, and their pins clash with each other's. A peer that is not set up, cannot be
installed or does not answer in time becomes a note on the page.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from meanflock.launch.engine import Engine

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms, per_tick_ms
from benchmarks.in_process import flight, learner_step
from benchmarks.peer.environment import Environment
from meanflock.federation.rules.base import mean
from meanflock.kernels.mean_field.layout import MODEL_FLOATS
from meanflock.swarm import scenario

TITLE = "Peers"
ABOUT = (
    "Each peer in a process and an environment of its own (`make peers`), in turns with our own at the nearest "
    "comparable work; *ratio* is ours to theirs. Ours does more: an in-process tick moves, learns, meters every link "
    "and encodes every message."
)

Measure = Callable[[int], float]  # how often → ms of one time


@dataclass(frozen=True)
class Race:
    """A peer's script and argument, and what of ours it is compared with."""

    peer: str
    script: str
    size: int
    theirs: str
    ours: str
    measure: Callable[[], Measure]
    count: int  # of a sample
    note: str = ""


def _learner(uavs: int) -> Measure:
    return partial(per_call_ms, learner_step("mfgfl-hf", uavs))


def _tick(method: str, uavs: int) -> Measure:
    return partial(per_tick_ms, flight(method, uavs).fly())


def _fedavg(models: int) -> Measure:
    draw = np.random.default_rng(1)
    return partial(per_call_ms, partial(mean, draw.random((models, MODEL_FLOATS))))


def _round(uavs: int) -> Measure:
    """Ticks in which a round is always open: three of them are a round."""
    period = 3
    flown = scenario.load(
        None, [f"federation.period={period}", "federation.fraction=1", "stop=duration", "duration=1e6"], uavs=uavs
    )
    ticks = Engine(flown, "benchmark").fly()
    return lambda count: period * per_tick_ms(ticks, period * count)


RACES = (
    Race(
        "gradysim",
        "gradysim_broadcasts",
        25,
        "0.1 s of 25 nodes that move and broadcast",
        "tick of 25 UAVs, hjb, in process",
        partial(_tick, "hjb", 25),
        10,
        "each of ours also learns, and each of its 600 links fades, is metered and may fail",
    ),
    Race(
        "gradysim",
        "gradysim_broadcasts",
        100,
        "0.1 s of 100 nodes that move and broadcast",
        "tick of 100 UAVs, hjb, in process",
        partial(_tick, "hjb", 100),
        2,
    ),
    Race(
        "vmas",
        "vmas_flocking",
        25,
        "flocking step of 25 agents, one environment",
        "tick of 25 UAVs, mfgfl-hf, in process",
        partial(_tick, "mfgfl-hf", 25),
        5,
        "its agents act but do not learn here",
    ),
    Race(
        "crazyflow",
        "crazyflow_control",
        25,
        "control step of 25 drones on the CPU: 10 ms of flight",
        "0.1 s of 25 UAVs, mfgfl-hf, in process: a tick",
        partial(_tick, "mfgfl-hf", 25),
        50,
        "its drones are rigid bodies on rotors, in five steps of physics, and neither learn nor talk; ours are points "
        "that do, and a tick flies ten times as far",
    ),
    Race(
        "pyrvo",
        "pyrvo_orca",
        25,
        "ORCA step of 25 agents",
        "learner step, 25 rows",
        partial(_learner, 25),
        100,
        "ORCA, in C++, plans from what every agent knows of every other; the learner learns",
    ),
    Race(
        "pyrvo",
        "pyrvo_orca",
        250,
        "ORCA step of 250 agents",
        "learner step, 250 rows",
        partial(_learner, 250),
        20,
    ),
    Race(
        "pfl",
        "pfl_round",
        25,
        "simulated round of 25 clients, 246 floats",
        "round of 25 UAVs in process: three ticks",
        partial(_round, 25),
        5,
        "its clients take one gradient step; ours learn in all three ticks and pay for the radio",
    ),
    Race(
        "flwr",
        "flwr_round",
        25,
        "round of its simulation engine, 25 clients, 246 floats",
        "three ticks of 25 UAVs in process: a round",
        partial(_round, 25),
        2,
        "its clients take one gradient step each, in a worker process for each core, and it looks for messages every "
        "0.1 s",
    ),
    Race(
        "flwr",
        "flwr_average",
        20,
        "average of 20 models of 246 floats",
        "fedavg of 20 models of 246 floats",
        partial(_fedavg, 20),
        100,
    ),
)


def run(effort: Effort, say: Say) -> Outcome:
    """Each race by itself; one that cannot be held is a note."""
    outcome = Outcome()
    for race in RACES:
        say(f"{race.peer}, {race.size}")
        try:
            outcome.figures += _hold(race, effort)
        except Exception as error:  # an error of one peer does not stop the others
            outcome.notes.append(f"{race.peer}, {race.theirs}: not measured: {error or type(error).__name__}")
    return outcome


def _hold(race: Race, effort: Effort) -> list[Figure]:
    with Environment(race.peer).start(race.script, race.size) as peer:
        ours = race.measure()
        ours(race.count)
        ms = in_turns(effort.choose(9, 3), {"peer": lambda: peer.measure(race.count), "ours": lambda: ours(race.count)})
    floor = Figure(f"{peer.version}: {race.theirs}", "ms", ms["peer"], "neither")
    return [Figure(f"ours: {race.ours}", "ms", ms["ours"], floor=floor, note=race.note), floor]


def main(arguments: list[str] | None = None) -> int:
    """`--setup`: makes the environments that are missing. 1 if one could not be made; the others are."""
    peers = list(dict.fromkeys(race.peer for race in RACES))
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__.splitlines()[0])
    parser.add_argument("--setup", nargs="*", choices=peers, metavar="PEER", required=True, help=", ".join(peers))
    parser.add_argument("--timeout", type=float, default=900.0, metavar="S", help="for each; default %(default).0f")
    given = parser.parse_args(arguments)
    code = 0
    for name in given.setup or peers:
        try:
            message = Environment(name).make(given.timeout)
        except Exception as error:
            message, code = f"cannot be had: {error or type(error).__name__}", 1
        print(f"{name}: {message}", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
