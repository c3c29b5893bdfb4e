"""Memory and start-up time of a process of the swarm."""

import re
import subprocess
import time
from pathlib import Path
from statistics import median

import psutil

from benchmarks import sizes
from benchmarks.figure import Effort, Figure, Outcome, Say, per_call_ms
from benchmarks.lockstep_floor import floor_of
from benchmarks.processes import Children
from meanflock.launch.station import RecordingStation
from meanflock.net import keys
from meanflock.net.networked import NetworkedRun
from meanflock.net.session import ZenohBus
from meanflock.swarm import scenario
from meanflock.swarm.errors import BusError

TITLE = "A process of the swarm"
ABOUT = (
    "Memory of the agents in flight: RSS as `top` shows it, and PSS, in which what 25 processes share is counted once "
    "in all. They are started as `meanflock run` starts them: forked from one that has loaded what an agent needs. "
    "*Up and joined* is the time from launching world, leader and 25 agents to the first tick. The floor is as many "
    "processes, forked likewise, that load Python, NumPy, msgspec and Zenoh, open a session and answer."
)
AGENTS = 25
UP_TARGET_S, UP_STRETCH_S = 6.0, 3.0
JOIN_TARGET_S = 0.3
RSS_TARGET_MIB, PSS_TARGET_MIB = 45e6 / 2**20, 20e6 / 2**20
TICKS_BEFORE_WEIGHING = 60
_DEADLINE_S = 60.0


def run(effort: Effort, say: Say) -> Outcome:
    """Swarm and floor in turns, then single agents."""
    up: dict[str, list[float]] = {"swarm": [], "floor": []}
    rss: dict[str, list[float]] = {"swarm": [], "floor": []}
    pss: dict[str, list[float]] = {"swarm": [], "floor": []}
    for repeat in range(effort.choose(3, 1)):
        for who, launch in (("floor", _floor), ("swarm", _swarm)):
            say(f"25 processes, {repeat + 1}: {who}")
            seconds, weights = launch()
            up[who].append(seconds)
            rss[who].append(median(weight[0] for weight in weights))
            pss[who].append(median(weight[1] for weight in weights))
    one: dict[str, list[float]] = {"agent": [], "floor": []}
    for repeat in range(effort.choose(5, 2)):
        say(f"one process, {repeat + 1}")
        one["floor"].append(_join_floor())
        one["agent"].append(_join_agent())
    up_floor = Figure("the floor's 25 processes up and answering", "s", up["floor"])
    rss_floor = Figure("RSS of a floor process", "MiB", rss["floor"])
    pss_floor = Figure("PSS of a floor process", "MiB", pss["floor"])
    one_floor = Figure("one floor process up", "s", one["floor"])
    return Outcome(
        [
            Figure(
                "25 agents, leader and world up and joined",
                "s",
                up["swarm"],
                floor=up_floor,
                target=UP_TARGET_S,
                stretch=UP_STRETCH_S,
            ),
            up_floor,
            Figure("one agent joins a waiting world", "s", one["agent"], floor=one_floor, target=JOIN_TARGET_S),
            one_floor,
            Figure("RSS of an agent in flight", "MiB", rss["swarm"], floor=rss_floor, target=RSS_TARGET_MIB),
            rss_floor,
            Figure("PSS of an agent in flight", "MiB", pss["swarm"], floor=pss_floor, target=PSS_TARGET_MIB),
            pss_floor,
        ]
    )


def memory_mib(process: "subprocess.Popen[bytes] | psutil.Process") -> tuple[float, float]:
    """RSS and PSS of a living process."""
    text = Path(f"/proc/{process.pid}/smaps_rollup").read_text(encoding="ascii")
    found = dict(re.findall(r"^(Rss|Pss):\s+(\d+) kB", text, re.MULTILINE))
    return int(found["Rss"]) / 1024, int(found["Pss"]) / 1024


def _swarm() -> tuple[float, list[tuple[float, float]]]:
    """Seconds to the first tick, and memory of the agents some ticks later."""
    with Children("weigh") as children:
        start = time.perf_counter()
        flags = ("--set", "stop=duration", "--set", "duration=3600", "--set", f"uavs={AGENTS}")
        world = children.start("meanflock.worldsim", "--stations", "1", *flags)
        children.start("meanflock.leader")
        agents = children.start("meanflock.agent", "--count", str(AGENTS))  # as `meanflock run` starts them
        bus = connected(children)
        try:
            bus.subscribe(keys.sense(children.run, "*"))
            station = RecordingStation(bus, children.run, [])
            asked = 0
            first_s = 0.0
            while asked < TICKS_BEFORE_WEIGHING * AGENTS:
                delivery = bus.receive(0.5)
                if delivery is None:
                    children.check()
                    if time.perf_counter() - start > _DEADLINE_S:
                        raise TimeoutError("the swarm does not fly")
                elif delivery.key.endswith("/sense"):
                    first_s = first_s or time.perf_counter() - start
                    asked += 1
                else:
                    station.handle(delivery)
            weights = [memory_mib(agent) for agent in psutil.Process(agents.pid).children()]
        finally:
            bus.close()
        world.terminate()
        children.wait(10.0)
    return first_s, weights


def connected(children: Children) -> ZenohBus:
    """Connect in short steps, as `meanflock run` does, because a try before the world listens waits for its timeout."""
    end = time.monotonic() + _DEADLINE_S
    while True:
        children.check()
        try:
            return ZenohBus.client(children.endpoint, 1.0)
        except BusError:
            if time.monotonic() > end:
                raise


def _floor() -> tuple[float, list[tuple[float, float]]]:
    names = [f"agent-{number}" for number in range(AGENTS)]
    asked = {name: (sizes.size(sizes.sense()), sizes.size(sizes.act())) for name in names}
    with Children("floor") as children:
        start = time.perf_counter()
        with floor_of(children, names) as world:
            clients = children.start("benchmarks.lockstep_floor", "--imports", "--count", str(AGENTS))
            world.gather()
            world.tick(asked)
            first_s = time.perf_counter() - start
            for _ in range(TICKS_BEFORE_WEIGHING):
                world.tick(asked)
            return first_s, [memory_mib(client) for client in psutil.Process(clients.pid).children()]


def _join_agent() -> float:
    """Seconds from the launch of `python -m meanflock.agent` until the swarm is complete."""
    with Children("single") as children:
        bus = ZenohBus.router(children.endpoint)
        try:
            world = NetworkedRun(scenario.load(None, method="mfg", uavs=1), bus, children.run)
            ms = per_call_ms(lambda: (children.start("meanflock.agent"), world.gather(_DEADLINE_S)), 1)
            world.nodes.stop("weighed")
            children.wait(2.0)
        finally:
            bus.close()
    return ms / 1e3


def _join_floor() -> float:
    with Children("single") as children, floor_of(children, ["agent-0"]) as world:
        start = ("benchmarks.lockstep_floor", "--imports", "--node", "agent-0")
        return per_call_ms(lambda: (children.start(*start), world.gather()), 1) / 1e3
