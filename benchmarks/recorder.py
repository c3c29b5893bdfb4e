"""Cost of recording in time and disk space, in one process and in a swarm of processes."""

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from benchmarks.figure import Effort, Figure, Outcome, Say, per_call_ms
from benchmarks.processes import Children
from meanflock.launch.engine import Engine
from meanflock.net import keys
from meanflock.net.networked import NetworkedRun
from meanflock.net.session import ZenohBus
from meanflock.recording.recorder import Recorder
from meanflock.results.run_folder import RECORDING, RunFolder
from meanflock.results.timeseries_file import TIMESERIES
from meanflock.swarm import scenario

TITLE = "The recorder"
ABOUT = (
    "The in-process swarm of 25 UAVs (mfgfl-hf) flown in turns without any recording, with the run folder alone (time "
    "series and events), and with `recording.rrd` too: there the share is of the CPU time of the thread that flies, "
    "which a busy machine hardly lengthens. In the swarm of processes all this is done by the ground station, "
    "beside the flight: there it is of the wall time of a tick, in turns with a recorder and with nobody who listens."
)
UAVS = 25
NETWORKED_TICKS, NETWORKED_TURN = 300, 20
CHUNK = 2000  # the recorder sends its rows in batches of as many ticks
TURN = 100  # ticks of one flight before the next has its turn: a shared machine is another one a second later
SHARE_TARGET = 10.0


def run(effort: Effort, say: Say) -> Outcome:
    """Three engines in turns."""
    flown = scenario.load(None, uavs=UAVS, stop="duration", duration=1e6)
    repeats = effort.choose(15, 2)
    with tempfile.TemporaryDirectory(prefix="meanflock-bench-") as out, ExitStack() as stack:
        plain_folder = stack.enter_context(RunFolder(Path(out), "folder", flown))
        full_folder = stack.enter_context(RunFolder(Path(out), "recorded", flown))
        rrd = full_folder.path / RECORDING
        recorder = stack.enter_context(Recorder(flown, "recorded", rrd))
        flights = {
            "without": Engine(flown, "without").fly(),
            "folder": Engine(flown, "folder", sinks=[plain_folder]).fly(),
            "recorded": Engine(flown, "recorded", sinks=[full_folder, recorder]).fly(),
        }
        wall: dict[str, list[float]] = {name: [] for name in flights}
        cpu: dict[str, list[float]] = {name: [] for name in flights}
        thread: dict[str, list[float]] = {name: [] for name in flights}
        for repeat in range(repeats + 1):
            say(f"{repeat} of {repeats}")
            spent = dict.fromkeys(flights, (0.0, 0.0, 0.0))
            for _ in range(CHUNK // TURN):
                for name, ticks in flights.items():
                    before = _clocks()
                    for _ in range(TURN):
                        next(ticks)
                    took = (now - then for now, then in zip(_clocks(), before, strict=True))
                    spent[name] = tuple(sum(pair) for pair in zip(spent[name], took, strict=True))
            for name, all_clocks in spent.items() if repeat else ():  # the first batch pays for what is made once
                for times, took_s in zip((wall, cpu, thread), all_clocks, strict=True):
                    times[name].append(took_s / CHUNK * 1e3)
        closing = time.perf_counter()
        recorder.close()
        closing_s = time.perf_counter() - closing
        stack.close()
        ticks_flown = (repeats + 1) * CHUNK
        rrd_mib = rrd.stat().st_size / 2**20 / ticks_flown * 1000
        series_mib = (full_folder.path / TIMESERIES).stat().st_size / 2**20 / ticks_flown * 1000
    floor = Figure("tick without recording", "ms/tick", wall["without"])
    share = [
        100 * (full - none) / full for full, none in zip(thread["recorded"], thread["without"], strict=True)
    ]  # of the recorded tick
    beside = _networked(effort, say)
    return Outcome(
        [
            Figure("recorder's share of a tick, 25 processes", "%", beside, target=SHARE_TARGET),
            Figure("tick recorded", "ms/tick", wall["recorded"], floor=floor),
            Figure("tick with the run folder only", "ms/tick", wall["folder"], floor=floor),
            floor,
            Figure("recorder's share of a tick, in one process", "%", share, target=SHARE_TARGET),
            Figure(
                "CPU of recording, all threads",
                "ms/tick",
                [full - none for full, none in zip(cpu["recorded"], cpu["without"], strict=True)],
            ),
            Figure("`recording.rrd`, 1000 ticks", "MiB", [rrd_mib]),
            Figure("`timeseries.parquet`, 1000 ticks", "MiB", [series_mib]),
            Figure("closing the recording", "s", [closing_s]),
        ]
    )


def _clocks() -> tuple[float, float, float]:
    """By the wall, of all threads, and of this one, s."""
    return time.perf_counter(), time.process_time(), time.thread_time()


def _networked(effort: Effort, say: Say) -> list[float]:
    """Two swarms of processes alive side by side and flown in turns, one with a ground station that records."""
    flown = scenario.load(None, uavs=UAVS, stop="duration", duration=1e6)
    share = []
    with Children("watched") as watched, Children("alone") as alone:
        say("starting 2 × 26 processes")
        buses = ZenohBus.router(watched.endpoint), ZenohBus.router(alone.endpoint)
        try:
            buses[0].announce(keys.alive(watched.run, "world", "world"))
            worlds = NetworkedRun(flown, buses[0], watched.run, stations=1), NetworkedRun(flown, buses[1], alone.run)
            watched.start("meanflock.groundstation", "--out", str(watched.folder / "runs"), "--rerun", "")
            for children, world in zip((watched, alone), worlds, strict=True):
                children.start("meanflock.leader")
                children.start("meanflock.agent", "--count", str(UAVS))
                world.gather(60.0)
            flights = [world.fly() for world in worlds]
            for repeat in range(effort.choose(9, 2) + 1):
                say(f"25 processes, {repeat}")
                spent = [0.0, 0.0]
                for _ in range(NETWORKED_TICKS // NETWORKED_TURN):
                    for which, ticks in enumerate(flights):
                        spent[which] += per_call_ms(lambda ticks=ticks: next(ticks), NETWORKED_TURN)
                with_recorder, without = spent
                if repeat:
                    share.append(100 * (with_recorder - without) / with_recorder)
            watched.check()
            worlds[0].finish(lambda: 0.0)
            worlds[1].nodes.stop("measured")
            for children in (watched, alone):
                children.wait(8.0)
        finally:
            for bus in buses:
                bus.close()
    return share
