"""The main use: agents as processes over Zenoh, which learn and are recorded."""

import itertools

from benchmarks import sizes
from benchmarks.figure import Effort, Figure, Outcome, Say, per_call_ms
from benchmarks.lockstep_floor import floor_of
from benchmarks.processes import Children, meanflock
from meanflock.worldsim.world import REPORT_EVERY_TICKS

TITLE = "The swarm of processes"
ABOUT = (
    "`meanflock run`: leader, world, ground station and one process a UAV, learning, metering and recording. Start-up "
    "is excluded, everything between first and last tick is not. The floor is a bare Zenoh lockstep of as many "
    "processes, forked from one as agents are, with the same session settings and messages of the same size, reported "
    "models among them, but no codec, learning, physics or recording."
)
SIM_TICK_S = 0.1
TARGETS = {25: (15.0, 25.0), 64: (4.0, 8.0)}  # times real time: target, stretch
FLOOR_RATIO = 1.5


def run(effort: Effort, say: Say) -> Outcome:
    """Fly 25 processes, and 64 at full effort, each against its floor."""
    outcome = Outcome()
    swarms = [(25, effort.choose(600, 200), effort.choose(9, 1))] + ([(64, 300, 5)] if effort is Effort.FULL else [])
    for uavs, ticks, repeats in swarms:
        flown = []
        bare = []
        start_s = []
        for repeat in range(repeats):
            say(f"{uavs} processes, {repeat + 1} of {repeats}: floor")
            bare.append(floor_tick_ms(uavs, effort.choose(500, 100)))
            say(f"{uavs} processes, {repeat + 1} of {repeats}: meanflock run")
            summary, command_s = meanflock(
                "--uavs", str(uavs), "--set", "stop=duration", "--duration", str(ticks * SIM_TICK_S)
            )
            flown.append(summary["wall_time_s"] / summary["ticks"] * 1e3)
            start_s.append(command_s - summary["wall_time_s"])
        target, stretch = TARGETS[uavs]
        floor = Figure(f"bare Zenoh lockstep, {uavs} processes", "ms/tick", bare)
        outcome.figures += [
            Figure(f"tick, {uavs} UAVs", "ms/tick", flown, floor=floor, ratio_stretch=FLOOR_RATIO),
            floor,
            Figure(f"ticks a second, {uavs} UAVs", "1/s", [1e3 / ms for ms in flown], "higher"),
            Figure(
                f"real-time factor, {uavs} UAVs",
                "×",
                [SIM_TICK_S * 1e3 / ms for ms in flown],
                "higher",
                target=target,
                stretch=stretch,
            ),
            Figure(f"the command beside its flight (start, join, finish), {uavs} UAVs", "s", start_s),
        ]
    return outcome


def floor_tick_ms(clients: int, ticks: int) -> float:
    """Mean time of a bare lockstep tick, ms."""
    names = [f"agent-{number}" for number in range(clients)]
    asked, reported = (
        {name: (sizes.size(sizes.sense()), sizes.size(sizes.act(report=report))) for name in names}
        for report in (False, True)
    )
    kinds = itertools.cycle([reported] + [asked] * (REPORT_EVERY_TICKS - 1))
    with Children("floor") as children, floor_of(children, names) as world:
        children.start("benchmarks.lockstep_floor", "--count", str(clients))
        world.gather()
        for _ in range(20):
            world.tick(next(kinds))
        return per_call_ms(lambda: world.tick(next(kinds)), ticks)
