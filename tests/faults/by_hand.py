"""World, leaders, agents and stations as processes that somebody starts by hand, freezes and kills."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from meanflock.launch.processes import free_endpoint
from meanflock.net.session import LEASE
from meanflock.results.spool import spooled
from tests.polling import DEADLINE_S, until

# A UAV whose agent comes back after thousands of ticks is far off and fast, where the paper's learners may diverge at
# once. This learner never does.
ENDLESS = ("uavs=3", "seed=7", "stop=duration", "federation.period=40", "duration=100000", "method=fed-lspi")
Process = subprocess.Popen[str]


def events_in(folder: Path) -> list[dict[str, Any]]:
    path = folder / "events.jsonl"
    lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
    return [json.loads(line) for line in lines]


def ticks_of(folder: Path) -> list[int]:
    return pq.read_table(folder / "timeseries.parquet", columns=["tick"])["tick"].to_pylist()


def spool_bytes(out: Path) -> int:
    return sum(path.stat().st_size for path in out.glob("*/.telemetry"))


class Processes:
    def __init__(self, run: str, *flags: str) -> None:
        self.base = ("--endpoint", free_endpoint(), "--run", run, *flags)
        self._started: list[Process] = []

    def start(
        self, module: str, *flags: str, base: tuple[str, ...] | None = None, env: dict[str, str] | None = None
    ) -> Process:
        line = [sys.executable, "-m", f"meanflock.{module}", *(self.base if base is None else base), *flags]
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        process: Process = subprocess.Popen(line, **pipes, text=True, env={**os.environ, **(env or {})})
        self._started.append(process)
        return process

    def world(self, *flags: str, settings: tuple[str, ...] = (), **options: Any) -> Process:
        words = (word for setting in settings for word in ("--set", setting))
        return self.start("worldsim", *flags, *words, **options)

    def station(self, out: Path, *flags: str, **options: Any) -> Process:
        return self.start("groundstation", "--out", str(out), "--rerun", "", *flags, **options)

    def close(self) -> None:
        for process in self._started:
            if process.poll() is None:
                process.kill()
            process.communicate()


class Recorded:
    """What a run that flies has written to the disk."""

    def __init__(self, out: Path) -> None:
        self.out = out

    @property
    def folder(self) -> Path:
        (folder,) = self.out.iterdir()
        return folder

    def flying(self, more: int = 5_000) -> None:
        """Waits until that many more bytes of telemetry are on the disk."""
        before = spool_bytes(self.out)
        until(lambda: spool_bytes(self.out) > before + more, "telemetry")

    def event(self, kind: str, count: int = 1, uavs: tuple[int, ...] | None = None) -> dict[str, Any]:
        """Waits for the count-th event of a kind; `uavs`: of exactly these."""

        def found() -> dict[str, Any] | None:
            events = self.events(kind, uavs)
            return events[count - 1] if len(events) >= count else None

        def seen() -> list[dict[str, Any]]:
            return [*self.events("lost"), *self.events(kind)]

        return until(found, f"{count} events {kind} of {uavs}", pause_s=0.1, seen=seen)

    def events(self, kind: str, uavs: tuple[int, ...] | None = None) -> list[dict[str, Any]]:
        events = [event for folder in self.out.glob("*") for event in events_in(folder) if event["kind"] == kind]
        return [event for event in events if uavs is None or event["uavs"] == [*uavs]]

    def count(self, kind: str, uavs: tuple[int, ...] | None = None) -> int:
        return len(self.events(kind, uavs))


class Flight(Recorded):
    def __init__(
        self,
        processes: Processes,
        out: Path,
        barrier_s: float = 10.0,
        settings: tuple[str, ...] = ENDLESS,
        agents: int = 3,
        leaders: int = 1,
        station_base: tuple[str, ...] | None = None,
        link_s: float | None = None,
    ) -> None:
        """`link_s`: how long the link between world and station outlives a station that is frozen."""
        super().__init__(out)
        self.processes = processes
        self._lease = {} if link_s is None else {LEASE: f"{link_s:g}"}
        flags = ("--stations", "1", "--barrier", str(barrier_s))
        self.world = processes.world(*flags, settings=settings, env=self._lease)
        self.station = processes.station(out, "--resume", "latest", base=station_base, env=self._lease)
        self.agents = [self.agent(uav) for uav in range(agents)]
        self.leaders = [self.leader() for _ in range(leaders)]

    def agent(self, uav: int, *flags: str, **options: Any) -> Process:
        return self.processes.start("agent", "--uav", str(uav), *flags, **options)

    def leader(self) -> Process:
        return self.processes.start("leader")

    def _rows(self) -> int:
        return max(
            (sum(len(one.block.states) for one in spooled(path)) for path in self.out.glob("*/.telemetry")), default=0
        )

    def station_again(self, number: signal.Signals) -> None:
        """Ends the station, and waits until another one records."""
        self.station.send_signal(number)
        self.station.communicate(timeout=DEADLINE_S)
        rows = self._rows()
        self.station = self.processes.station(self.out, "--resume", "latest", env=self._lease)
        until(lambda: self._rows() > rows, "another station records", pause_s=0.1)

    def end(self) -> dict[str, Any]:
        """Ends an endless flight; its summary."""
        self.world.send_signal(signal.SIGINT)
        out, _ = self.world.communicate(timeout=DEADLINE_S)
        return json.loads(out)


def ends_by_itself(process: Process) -> str:
    """Its standard output."""
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    return out
