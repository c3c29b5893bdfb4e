"""`python -m tests.soak.start_up`: a hundred agents, started at once, all of which join and fly. Needs about 5.5 GB."""

import argparse
import json
import sys
import time

import psutil
from rich.console import Console

from benchmarks.processes import Children
from meanflock.swarm.errors import BusError
from meanflock.swarm.net import keys
from meanflock.swarm.net.session import ZenohBus
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Finished, Telemetry

JOIN_S = 180.0
TICKS = 30


def main() -> int:
    """0 where every UAV flew with its agent to the end, else 1."""
    options = argparse.ArgumentParser(prog="python -m tests.soak.start_up", description=__doc__)
    options.add_argument("--agents", type=int, default=100, help="processes (default 100)")
    given = options.parse_args()
    settings = (f"uavs={given.agents}", "stop=duration", f"duration={TICKS / 10}", "federation.period=10")
    flags = [word for setting in settings for word in ("--set", setting)]
    console = Console()
    with Children("start-up") as children:
        started = time.monotonic()
        world = children.start("worldsim", "--wait", str(JOIN_S), "--barrier", "60", *flags)
        for _ in range(given.agents):
            children.start("agent", "--wait", str(JOIN_S))
        children.start("leader", "--wait", str(JOIN_S))
        bus = _connected(children)
        bus.subscribe(keys.telemetry(children.run))
        bus.watch(keys.alive(children.run, "agent", "*"))
        tokens, first_tick_s, memory, summary = set[str](), 0.0, 0.0, b""
        joined_s: list[float] = []
        try:
            while not summary and time.monotonic() - started < 2 * JOIN_S:
                delivery = bus.receive(0.1)
                if world.poll():
                    break
                if delivery is None or delivery.kind == "gone":
                    continue
                if delivery.kind == "alive":
                    tokens.add(delivery.key)
                    joined_s.append(time.monotonic() - started)
                elif isinstance(message := control.decode(delivery.payload), Finished):
                    summary = message.summary
                elif isinstance(message, Telemetry) and not first_tick_s:
                    first_tick_s = time.monotonic() - started
                    memory = sum(psutil.Process(p.pid).memory_info().rss for p in children.processes) / 2**30
        finally:
            bus.close()
        children.wait(60.0)
        codes = sorted({process.poll() for process in children.processes}, key=str)
    lost = json.loads(summary)["lost"] if summary else None
    console.print(f"{len(tokens)} of {given.agents} agents joined, the last after {max(joined_s, default=0):.1f} s")
    console.print(f"first telemetry after {first_tick_s:.1f} s; {memory:.1f} GiB of RSS in all; exit codes {codes}")
    console.print(f"UAVs lost: {lost}")
    return 0 if len(tokens) == given.agents and lost == 0 and codes == [0] else 1


def _connected(children: Children) -> ZenohBus:
    while True:
        try:
            return ZenohBus.client(children.endpoint, 10.0)
        except BusError:
            children.check()


if __name__ == "__main__":
    sys.exit(main())
