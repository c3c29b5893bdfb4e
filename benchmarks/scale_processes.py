"""Cost of a process in swarms of up to 200; slow, so it runs only on request."""

import time
from itertools import pairwise

import psutil

from benchmarks.agent_process import connected, memory_mib
from benchmarks.figure import Effort, Figure, Outcome, Say
from benchmarks.networked import floor_tick_ms
from benchmarks.processes import BenchmarkFailed, Children
from meanflock.launch.memory import available_mb, needed_mb
from meanflock.launch.station import RecordingStation
from meanflock.swarm.wire.messages import Telemetry

TITLE = "From 25 to 200 processes"
ABOUT = (
    "One UAV a process, mfgfl-hf; world, leader and agents are processes, the listener is this program and keeps "
    "nothing. The floor is a bare Zenoh lockstep of as many processes. PSS is what the agents weigh together, shared "
    "pages counted once."
)
PROCESSES = (25, 50, 100, 200)
WARM_TICKS = 40
_DEADLINE_S = 120.0


class Stopwatch:
    """Sink that stores the arrival time of each block, s, and the ticks since take-off."""

    def __init__(self) -> None:
        self.ticks: list[int] = []
        self.seconds: list[float] = []

    def write(self, block: Telemetry) -> None:
        self.ticks.append(block.first_tick)
        self.seconds.append(time.perf_counter())

    def tick_ms(self) -> list[float]:
        """Mean time of a tick between one block and the next, ms, once warm."""
        came = [pair for pair in zip(self.ticks, self.seconds, strict=True) if pair[0] >= WARM_TICKS]
        return [1e3 * (t1 - t0) / (k1 - k0) for (k0, t0), (k1, t1) in pairwise(came)]


def run(effort: Effort, say: Say) -> Outcome:
    """Each number of processes once, its ticks in blocks of 20."""
    outcome = Outcome(details={"samples": []})
    for processes in PROCESSES if effort is Effort.FULL else PROCESSES[:2]:
        needed, (available, limit) = needed_mb(processes, processes), available_mb()
        if needed > available:
            outcome.notes.append(f"{processes} processes need {needed} MB; {available} MB are {limit}")
            continue
        say(f"{processes} processes: floor")
        bare = [floor_tick_ms(processes, effort.choose(5000, 1000) // processes)]
        say(f"{processes} processes: swarm")
        ms, joined_s, pss = _swarm(processes, effort.choose(6000, 2000) // processes)
        floor = Figure(f"bare Zenoh lockstep, {processes} processes", "ms/tick", bare)
        tick = Figure(f"tick, {processes} processes", "ms/tick", ms)
        outcome.figures += [
            Figure(tick.name, tick.unit, ms, floor=floor),
            floor,
            Figure(f"PSS of {processes} agents", "MiB", [pss]),
            Figure(f"{processes} agents, leader and world up and joined", "s", [joined_s]),
        ]
        outcome.details["samples"].append({"uavs": processes, "processes": processes, "links": 0, "ms": min(ms)})
    return outcome


def _swarm(agents: int, ticks: int) -> tuple[list[float], float, float]:
    """Times of ticks in ms, seconds until all have joined, and the agents' PSS together, MiB."""
    with Children("processes") as children:
        launched = time.perf_counter()
        world = children.start(
            "worldsim", "--stations", "1", "--set", "stop=duration", "--set", "duration=1e5", "--set", f"uavs={agents}"
        )
        children.start("meanflock.leader")
        forked = children.start("meanflock.agent", "--count", str(agents))
        bus = connected(children)
        try:
            watch = Stopwatch()
            station = RecordingStation(bus, children.run, [watch])
            while not watch.ticks or watch.ticks[-1] < max(ticks, 3 * WARM_TICKS):
                delivery = bus.receive(0.5)
                if delivery is not None:
                    station.handle(delivery)
                    continue
                children.check()
                if time.perf_counter() - launched > _DEADLINE_S:
                    raise BenchmarkFailed(f"{agents} processes do not fly {ticks} ticks in {_DEADLINE_S:.0f} s")
            pss = sum(memory_mib(agent)[1] for agent in psutil.Process(forked.pid).children())
        finally:
            bus.close()
        world.terminate()
        children.wait(20.0)
    return watch.tick_ms(), watch.seconds[0] - launched, pss
