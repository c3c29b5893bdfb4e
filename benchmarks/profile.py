"""Profile of a tick. Functions of meanflock are wrapped for the measurement, and restored after it.

Times are exclusive: time that a wrapped function spends in another one counts there only. `python -m
benchmarks.profile` is an agent that measures itself.
"""

import argparse
import importlib
import json
import resource
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

from benchmarks.figure import Effort, Figure, Outcome, Say, per_tick_ms
from meanflock.agent.node import Agent
from meanflock.net import keys
from meanflock.net.client import NodeClient
from meanflock.net.process import orphaned
from meanflock.net.session import ZenohBus
from meanflock.swarm.wire.messages import Act, Join, Sense

TITLE = "Where a tick goes"
ABOUT = (
    "Exclusive times by wrapping functions from outside. In one process: wall time of 25 UAVs, mfgfl-hf. Over the "
    "network: wall time in the world's process, and CPU time in one agent among 25, recorded by a ground station."
)
UAVS = 25

Part = tuple[str, str]  # "module:name" or "module:Class.name", label

LEARNER: list[Part] = [
    ("meanflock.kernels:learn", "the learners' kernel"),
    ("meanflock.agent.controllers.mean_field.learner:MeanFieldLearner.step", "learner, the rest"),
    ("meanflock.agent.node:Agent.act", "agent: inbox, outbox, checks"),
    ("meanflock.net.client:NodeClient.handle", "agent: protocol"),
]
CODEC: list[Part] = [
    (f"meanflock.net.tick:{name}", "codec") for name in ("read_sense", "read_act", "write_sense", "write_act")
]
WORLD: list[Part] = [
    ("meanflock.worldsim.world:World.ask", "world, the rest of the tick"),
    ("meanflock.worldsim.world:World.move", "world, the rest of the tick"),
    ("meanflock.net.remote:RemoteCrew._ask", "address and fill inboxes"),
    ("meanflock.net.barrier:Barrier.ask", "address and fill inboxes"),
    ("meanflock.net.remote:RemoteCrew._in_lockstep", "barrier, the loop"),
    ("meanflock.net.admission:Admission.handle", "take in replies"),
    ("meanflock.net.barrier:Replies.read", "read and check replies"),
    ("meanflock.net.remote:RemoteCrew._collect", "collect commands and frames"),
    ("meanflock.worldsim.crew:LocalCrew.hear", "address and fill inboxes"),
    ("meanflock.worldsim.crew:LocalCrew.speak", "collect commands and frames"),
    ("meanflock.worldsim.commands:Commands.store", "collect commands and frames"),
    ("meanflock.worldsim.merger:FrameMerger.merged", "collect commands and frames"),
    ("meanflock.worldsim.world:World._begin_faults", "fault script"),
    ("meanflock.worldsim.world:World.checkpoint", "checkpoints"),
    ("meanflock.worldsim.reporting:Blocks.write", "telemetry"),
    ("meanflock.net.outbox:Outbox.add", "telemetry"),
    ("meanflock.net.outbox:Outbox.publish", "telemetry"),
    ("meanflock.launch.station:RecordingStation.handle", "telemetry"),
    ("meanflock.channel.medium:Medium.send", "channel"),
    ("meanflock.channel.medium:Medium.due", "channel"),
    ("meanflock.worldsim.flight:Flight.advance", "flight: arrivals, events"),
    ("meanflock.worldsim.vehicles.base:Physics.step", "flight: motion"),
    ("meanflock.worldsim.books:Noise.next", "flight: wind"),
    ("meanflock.worldsim.books:Books.add", "flight: books"),
    ("meanflock.worldsim.books:Books.settle", "flight: books"),
    ("meanflock.worldsim.flight:pairs", "flight: close pairs"),
]
ZENOH_BUS: list[Part] = [("meanflock.net.session:ZenohBus.put", "bus: put")]


class Stopwatch:
    """Exclusive time and calls by label; a context that removes its wrappers at the end."""

    def __init__(self, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        self.ns: Counter[str] = Counter()
        self.calls: Counter[str] = Counter()
        self._clock = clock
        self._thread = threading.get_ident()  # whose time it is
        self._beside: set[str] = set()  # labels of what other threads did meanwhile
        self._local = threading.local()  # of each thread: what it spent in wrapped functions within those under way
        self._undo: list[tuple[Any, str, Any]] = []
        self.absent: list[str] = []  # names that are no longer there

    def __enter__(self) -> "Stopwatch":
        return self

    def __exit__(self, _t: type[BaseException] | None, _e: BaseException | None, _b: TracebackType | None) -> None:
        for owner, attribute, original in reversed(self._undo):
            setattr(owner, attribute, original)

    def wrap(self, parts: Iterable[Part]) -> None:
        """Times these functions from now on; objects that already hold a bound method of one keep it as it was."""
        for name, label in parts:
            module, _, path = name.partition(":")
            *owners, attribute = path.split(".")
            try:
                owner: Any = importlib.import_module(module)
                for part in owners:
                    owner = getattr(owner, part)
                original = getattr(owner, attribute)
            except (ImportError, AttributeError):
                self.absent.append(name)
                continue
            self._undo.append((owner, attribute, original))
            setattr(owner, attribute, self._timed(original, label))

    def clear(self) -> None:
        """Forgets what was measured so far; from now on it is the time of the thread that calls this."""
        self._thread = threading.get_ident()
        self.ns.clear()
        self.calls.clear()

    def _timed(self, original: Callable[..., Any], label: str) -> Callable[..., Any]:
        clock = self._clock
        local = self._local
        ns = self.ns
        calls = self.calls

        def timed(*args: Any, **named: Any) -> Any:
            inner: list[int] = local.__dict__.setdefault("inner", [0])
            inner.append(0)
            start = clock()
            try:
                return original(*args, **named)
            finally:
                elapsed = clock() - start
                name = label
                if threading.get_ident() != self._thread:
                    name = f"{label}, in Zenoh's thread meanwhile"
                    self._beside.add(name)
                ns[name] += elapsed - inner.pop()
                calls[name] += 1
                inner[-1] += elapsed

        return timed

    def parts(self, ticks: int, total_us: float) -> list[dict[str, Any]]:
        """Largest first: µs, share and calls a tick; what no label has is "everything else"; all but what
        other threads did meanwhile makes up the total."""
        rows = [
            {"part": label, "us": ns / 1e3 / ticks, "calls": self.calls[label] / ticks} for label, ns in self.ns.items()
        ]
        rest = total_us - sum(row["us"] for row in rows if row["part"] not in self._beside)
        rows.append({"part": "everything else", "us": rest, "calls": None})
        return [row | {"share": row["us"] / total_us} for row in sorted(rows, key=lambda row: -row["us"])]


def run(effort: Effort, say: Say) -> Outcome:
    """Both breakdowns."""
    say("in one process")
    details = {"in_process": _in_process(effort)}
    say("over the network")
    details |= _networked(effort)
    world, agent = details["world"], details["agent"]
    absent = sorted({name for part in details.values() for name in part["absent"]})
    compute_ms = agent["cpu_us"] / 1e3 * UAVS
    return Outcome(
        [
            Figure("networked tick, profiled", "ms/tick", [world["tick_us"] / 1e3], "neither"),
            Figure("CPU of one agent", "µs/tick", [agent["cpu_us"]]),
            Figure("CPU of 25 agents together", "ms/tick", [compute_ms]),
            Figure("CPU of the world, all threads", "µs/tick", [world["cpu_us"]]),
            Figure("context switches of one agent", "1/tick", [agent["switches"]]),
        ],
        [f"Not found, so counted with what calls it: {', '.join(absent)}"] if absent else [],
        details,
    )


def _in_process(effort: Effort) -> dict[str, Any]:
    from benchmarks.in_process import flight

    ticks = effort.choose(1000, 200)
    plain_us = 1e3 * per_tick_ms(flight("mfgfl-hf", UAVS).fly(), ticks)
    with Stopwatch() as watch:
        watch.wrap([*LEARNER, *WORLD])
        flown = flight("mfgfl-hf", UAVS).fly()
        next(flown)
        watch.clear()
        total_us = 1e3 * per_tick_ms(flown, ticks)
    parts = watch.parts(ticks, total_us)
    return {"tick_us": total_us, "unprofiled_tick_us": plain_us, "parts": parts, "absent": watch.absent}


def _networked(effort: Effort) -> dict[str, Any]:
    """Profile a swarm: the world in this process, one agent of 25 that measures itself, and a ground station."""
    from benchmarks.processes import Children
    from meanflock.net.networked import NetworkedRun
    from meanflock.swarm import scenario

    ticks = effort.choose(600, 150)
    flown = scenario.load(None, uavs=UAVS, stop="duration", duration=1e6)
    with Children("profile") as children, Stopwatch() as watch:
        bus = ZenohBus.router(children.endpoint)
        try:
            bus.announce(keys.alive(children.run, "world", "world"))
            report, out = children.folder / "agent.json", children.folder / "runs"
            watch.wrap([*CODEC, *WORLD, *ZENOH_BUS, ("meanflock.net.session:ZenohBus.receive", "wait for replies")])
            world = NetworkedRun(flown, bus, children.run, stations=1)
            children.start("meanflock.groundstation", "--out", str(out), "--rerun", "")
            children.start("meanflock.leader")
            children.start("benchmarks.profile", "--report", str(report), "--ticks", str(ticks))
            children.start("meanflock.agent", "--count", str(UAVS - 1))
            world.gather(60.0)
            flight = world.fly()
            for _ in range(20):
                next(flight)
            watch.clear()
            cpu = time.process_time()
            tick_us = 1e3 * per_tick_ms(flight, ticks)
            cpu_us = (time.process_time() - cpu) / ticks * 1e6
            parts = watch.parts(ticks, tick_us)
            for _ in range(30):  # until the measuring agent has written its result
                next(flight)
            children.check()
            agent = json.loads(report.read_text(encoding="utf-8"))
            world.finish(lambda: 0.0)
            children.wait(8.0)
        finally:
            bus.close()
    found = {"tick_us": tick_us, "cpu_us": cpu_us, "parts": parts, "absent": watch.absent}
    return {"world": found, "agent": agent}


class _Weighed(Agent):
    """An agent that measures its process at two ticks."""

    stopwatch: Stopwatch
    first = 20
    last = 0
    report = Path()

    def act(self, sense: Sense) -> Act:
        """Act as an agent; at the last tick write the result."""
        tick = sense.tick
        if tick == self.first:
            self.stopwatch.clear()
            self._before = _used()
        if tick == self.last:
            ticks = self.last - self.first
            cpu, main, switches = (now - then for now, then in zip(_used(), self._before, strict=True))
            parts = self.stopwatch.parts(ticks, main / 1e3 / ticks)
            zenoh = {"part": "Zenoh's threads", "us": (cpu - main) / 1e3 / ticks, "calls": None}
            total = cpu / 1e3 / ticks
            rows = [{**row, "share": row["us"] / total} for row in (*parts, zenoh)]
            rows.sort(key=lambda row: -row["us"])
            absent = self.stopwatch.absent
            found = {"cpu_us": total, "switches": switches / ticks, "parts": rows, "absent": absent}
            self.report.write_text(json.dumps(found), encoding="utf-8")
        return super().act(sense)


def _used() -> tuple[int, int, int]:
    """CPU of the process and of this thread in ns, context switches."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return time.process_time_ns(), time.thread_time_ns(), usage.ru_nvcsw + usage.ru_nivcsw


def main() -> None:
    """`python -m meanflock.agent`, with measurement."""
    options = argparse.ArgumentParser()
    options.add_argument("--endpoint", required=True)
    options.add_argument("--run", required=True)
    options.add_argument("--report", type=Path, required=True)
    options.add_argument("--ticks", type=int, required=True)
    given = options.parse_args()
    bus = ZenohBus.client(given.endpoint)
    try:
        with Stopwatch(time.thread_time_ns) as watch:
            _Weighed.stopwatch, _Weighed.report = watch, given.report
            _Weighed.last = _Weighed.first + given.ticks
            watch.wrap([*LEARNER, *CODEC, *ZENOH_BUS, ("meanflock.net.session:ZenohBus.receive", "bus: receive")])
            client = NodeClient(bus, given.run)
            client.join(Join("agent", 1), _Weighed, 60.0)
            client.serve(lambda: False, orphaned)
    finally:
        bus.close()


if __name__ == "__main__":
    main()
