"""A long flight in which something goes wrong all the time, and the promises that must hold at its end."""

import hashlib
import json
import os
import signal
import subprocess
import threading
import time
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq

from meanflock.federation.plan import plan_of
from meanflock.federation.schedule import Schedule
from meanflock.launch import certs
from meanflock.recording.replay import verify
from meanflock.results.series import states_of
from meanflock.swarm.scenario import load
from tests.faults.by_hand import Flight, Processes, events_in
from tests.polling import DEADLINE_S
from tests.soak.mishaps import Mishaps
from tests.soak.vitals import Vitals

AT_ONCE = 3  # mishaps
BARRIER_S = 6.0  # below `LINK_SURE_S`; longer than an agent of a loaded machine may take
SAMPLE_EVERY_S = 1.0
LAST_TICKS = 2000  # in which mishaps are mended and no other begins; an agent may wait a minute for a taken place
PULSE_S, HELD_S = 0.02, 0.4  # the flight goes on in pulses, so that processes start within few ticks


@dataclass
class Report:
    seconds: float = 0.0
    mishaps: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)
    events: Counter[str] = field(default_factory=Counter)
    summary: dict[str, Any] = field(default_factory=dict)
    slopes: dict[str, tuple[float, float, float]] = field(default_factory=dict)


def settings(uavs: int, ticks: int, seed: int) -> tuple[str, ...]:
    """A flight with rounds, and a fault of the model every 100 ticks or so; its learner never diverges."""
    script = []
    for tick in range(100, ticks - 100, 400):
        uav, other = 1 + tick % (uavs - 1), 1 + (tick + 1) % (uavs - 1)  # UAV 0 averages
        script += [
            f'{{kind="partition", tick={tick}, duration_s=8.0, uavs=[{uav}]}}',
            f'{{kind="jam", tick={tick + 90}, duration_s=5.0, uavs=[{uav}, {other}]}}',
            f'{{kind="gust", tick={tick + 170}, duration_s=2.0, acceleration=[0.3, -0.2]}}',
            f'{{kind="pause", tick={tick + 250}, duration_s=3.0, uavs=[{other}]}}',
        ]
    mission = (f"duration={(ticks + LAST_TICKS) / 10}", "stop=duration", "method=fed-lspi", "federation.period=40")
    patient = ("pace.wait_share=1", "pace.rejoins=1000")  # nodes are hurt more often than a run allows
    return (f"uavs={uavs}", f"seed={seed}", *mission, *patient, f"faults=[{', '.join(script)}]")


class Soak:
    """One flight. It ends when it has flown so many ticks with as many mishaps as belong to them."""

    def __init__(self, uavs: int, ticks: int, every: int, seed: int, out: Path) -> None:
        """`every`: ticks between two mishaps, on average."""
        self._ticks, self._every = ticks, every
        self._runs, scratch, certificates = out / "runs", out / "scratch", out / "certs"
        certs.init(certificates, uavs)
        self._settings = settings(uavs, ticks, seed)
        self._scenario = load(None, self._settings)
        self._processes = Processes(f"soak-{os.getpid()}-{seed}", "--tls", str(certificates))
        self._flight = Flight(
            self._processes,
            self._runs,
            BARRIER_S,
            self._settings,
            agents=uavs,
            leaders=2,
            link_s=DEADLINE_S,  # the world does not keep for a frozen station what another one has acknowledged
        )
        self._mishaps = Mishaps(self._flight, certificates, scratch, seed)
        self._over = threading.Event()
        self._open: list[str] = []  # mishaps that are not mended yet
        self.report = Report(mishaps=self._mishaps.happened)

    def run(self) -> Report:
        started, vitals = time.monotonic(), Vitals(self._flight)
        try:
            self._flight.event("round")
            with ThreadPoolExecutor(AT_ONCE) as threads:
                hurting = [threads.submit(self._hurt) for _ in range(AT_ONCE)]
                try:
                    self._pace(vitals, hurting)
                finally:
                    self._over.set()
            for thread in hurting:
                thread.result()
            vitals.sample(self._tick, all_well=True)
            self._end()
        except (AssertionError, OSError, psutil.Error, subprocess.TimeoutExpired) as error:
            self.report.broken.append(f"{type(error).__name__}: {error}")
        finally:
            self._processes.close()
        self.report.broken += vitals.broken()
        self.report.slopes = vitals.slopes()
        self.report.seconds = time.monotonic() - started
        return self.report

    @property
    def _tick(self) -> int:
        """The tick of the last event."""
        return max((e["tick"] for folder in self._runs.glob("*") for e in events_in(folder)[-1:]), default=0)

    def _hurt(self) -> None:
        """One mishap after another, until the flight is over."""
        while not self._over.is_set():
            behind = self._mishaps.happened.total() * self._every <= self._tick
            mishap = self._mishaps.next() if behind else None
            if mishap is None:
                self._over.wait(0.1)
            else:
                try:
                    self._open.append(mishap.__name__)
                    mishap()
                    self._mishaps.over(mishap)
                    self._open.remove(mishap.__name__)
                except BaseException:
                    self._over.set()
                    raise

    def _pace(self, vitals: Vitals, hurting: list[Future[None]]) -> None:
        """Freezes the agent of UAV 0 for most of the time, and so holds the flight, until all mishaps are mended."""
        agent, sampled = self._flight.agents[0], 0.0
        while not all(thread.done() for thread in hurting):
            tick, mishaps = self._tick, self._mishaps.happened.total()
            if min(tick, mishaps * self._every) >= self._ticks:
                self._over.set()
            assert self._flight.world.poll() is None, f"the world ended in tick {tick} of {self._open}"
            if time.monotonic() - sampled > SAMPLE_EVERY_S:
                sampled = time.monotonic()
                vitals.sample(tick, all_well=mishaps == 0)
            agent.send_signal(signal.SIGSTOP)
            time.sleep(HELD_S)
            agent.send_signal(signal.SIGCONT)
            time.sleep(PULSE_S)

    def _end(self) -> None:
        """Waits for the end of the flight; every process ends by itself, and the folder is whole."""
        flight = self._flight
        out, err = flight.world.communicate(timeout=DEADLINE_S)
        assert flight.world.returncode == 0, err
        summary = self.report.summary = json.loads(out)
        for process in (flight.station, *flight.agents, *flight.leaders):
            _, err = process.communicate(timeout=DEADLINE_S)
            self._check(process.returncode == 0 and "Traceback" not in err, f"a process ended with: {err}")
        (folder,) = self._runs.iterdir()
        events = events_in(folder)
        kinds = self.report.events = Counter(event["kind"] for event in events)
        voids = [event for event in events if event["event"] == "round-ended" and event["kind"] == "void"]
        calendar = Schedule(plan_of(self._scenario))
        rounds = sum(calendar.closes(tick) > 0 for tick in range(summary["ticks"]))
        table = pq.read_table(folder / "timeseries.parquet")
        flown = hashlib.sha256(states_of(table).astype("<f8").tobytes()).hexdigest()
        counted = summary["rounds"] + summary["rounds_void"]
        for holds, promise in (
            (json.loads((folder / "summary.json").read_text()) == summary, "the summary is another"),
            (summary["ticks"] == self._scenario.max_ticks, f"{summary['ticks']} ticks flown"),
            (summary["lost"] == 0, f"{summary['lost']} UAVs lost at the end"),
            (
                summary["nodes_lost"] == self._mishaps.lost,
                f"{summary['nodes_lost']} nodes lost, not {self._mishaps.lost}",
            ),
            (counted == rounds, f"{counted} rounds averaged or void, of {rounds}"),
            (not any("no leader" in event["fields"]["reason"] for event in voids), f"void rounds: {voids}"),
            (summary["telemetry_blocks_dropped"] == 0, "telemetry was dropped"),
            (table["tick"].to_pylist() == list(range(summary["ticks"] + 1)), "rows are missing or there twice"),
            (flown == summary["trajectory_sha256"], "the rows are not the trajectory"),
            (kinds["finished"] == 1 and kinds["round"] == summary["rounds"], f"events: {dict(kinds)}"),
            (verify(folder / "recording.rrd") is None, "the recording is damaged"),
        ):
            self._check(holds, promise)

    def _check(self, holds: bool, promise: str) -> None:
        if not holds:
            self.report.broken.append(promise)
