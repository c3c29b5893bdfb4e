"""A long flight in which something goes wrong all the time, and the promises that must hold at its end."""

import hashlib
import json
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq

from groundstation.results import CHECKPOINT, states_of
from groundstation.viewer import verify
from swarm.rounds import Rounds
from tests.soak.mishaps import BadDay, Mishap
from tests.soak.swarm import Flock
from tests.soak.vitals import Vitals

AT_ONCE = 3  # mishaps that are not mended yet
DEADLINE_S = 180.0  # for anything a mishap waits for; the machine may be busy
SAMPLE_EVERY_S = 1.0
_HOLD_S = 0.2


@dataclass
class Report:
    """What a soak came to."""

    ticks: int = 0
    seconds: float = 0.0
    mishaps: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)
    events: Counter[str] = field(default_factory=Counter)
    summary: dict[str, Any] = field(default_factory=dict)
    slopes: dict[str, tuple[float, float, float]] = field(default_factory=dict)


@dataclass
class _Open:
    name: str
    script: Mishap
    waits_for: str
    met: Callable[[], bool]
    since: float


class Soak:
    """One flight."""

    def __init__(
        self,
        uavs: int,
        ticks: int,
        every: int,
        seed: int,
        out: Path,
        told: Callable[[int, str], None] = lambda t, s: None,
    ) -> None:
        """`every`: ticks between two mishaps, on average. `told`: called with the tick and what goes on."""
        self._uavs, self._ticks, self._every, self._seed, self._out = uavs, ticks, every, seed, out
        self._told = told
        self._draw = random.Random(f"times {seed}")
        self._open: list[_Open] = []
        self.report = Report()

    def run(self) -> Report:
        """Flies, hurts, mends, and looks what is left."""
        started = time.monotonic()
        mine = psutil.Process().num_fds()
        with Flock(self._uavs, self._ticks, self._seed, self._out) as flock:
            vitals = Vitals(flock)
            try:
                self._assemble(flock)
                self._fly(flock, vitals, BadDay(flock, self._seed))
                self._end(flock)
            except (AssertionError, psutil.Error) as error:
                self.report.broken.append(f"{error}; the processes' last words:\n{flock.said()}")
            self.report.ticks, self.report.events, self.report.slopes = flock.tick, flock.kinds(), vitals.slopes()
            self.report.broken += vitals.broken()
            left = [p.pid for p in flock.children.processes if p.poll() is None]
        if left and not self.report.broken:
            self.report.broken.append(f"processes {left} did not end by themselves")
        if psutil.Process().num_fds() > mine + 8:  # the Zenoh runtime of this process keeps its own
            self.report.broken.append(f"descriptors of this process: {mine} before, {psutil.Process().num_fds()} after")
        self.report.seconds = time.monotonic() - started
        return self.report

    # -- the flight -------------------------------------------------------------------------------------------------

    def _assemble(self, flock: Flock) -> None:
        day = BadDay(flock, self._seed)
        for _ in range(2):
            self._begin("take-off", day.another_leader())
            self._until(flock, lambda: not self._open, "leaders")
        for uav in range(self._uavs):
            flock.start_agent(uav)
        self._until(flock, lambda: flock.tick > 0, "the first ticks")

    def _fly(self, flock: Flock, vitals: Vitals, day: BadDay) -> None:
        due, sampled = float(self._every), 0.0
        quiet = self._ticks - max(2 * self._every, 100)
        while not flock.ended and flock.tick < self._ticks:
            if due <= flock.tick < quiet and len(self._open) < AT_ONCE:
                name, script = day.next()
                self.report.mishaps[name] += 1
                self._begin(name, script)
                due += self._draw.uniform(0.5, 1.5) * self._every
            # Mending takes a process some thousand milliseconds, the swarm some hundred ticks: it is held meanwhile.
            behind = due <= flock.tick and len(self._open) >= AT_ONCE
            if (behind or flock.tick >= quiet) and self._open:
                self._hold(flock, day.idle_agent())
            else:
                flock.listen(0.02)
            self._go_on()
            if time.monotonic() - sampled > SAMPLE_EVERY_S or (flock.tick >= quiet and not self._open):
                sampled = time.monotonic()
                vitals.sample(all_well=not self._open)
            self._told(flock.tick, ", ".join(o.name for o in self._open))
            assert flock.world.poll() in (None, 0), f"the world ended with {flock.world.poll()}"
        self._until(flock, lambda: flock.ended and not self._open, "the end")
        if flock.kinds()["finished"]:
            self._promise(day, flock)

    def _hold(self, flock: Flock, uav: int) -> None:
        """Everybody waits for an agent that is frozen for a moment, then takes a few ticks."""
        process = flock.agents[uav]
        process.send_signal(signal.SIGSTOP)
        flock.listen(_HOLD_S)
        process.send_signal(signal.SIGCONT)
        flock.listen(0.05)

    def _begin(self, name: str, script: Mishap) -> None:
        opened = _Open(name, script, "", lambda: True, time.monotonic())
        self._open.append(opened)
        self._go_on()

    def _go_on(self) -> None:
        """Every mishap whose condition is met takes its next step."""
        for opened in list(self._open):
            if opened.met():
                try:
                    opened.waits_for, opened.met = next(opened.script)
                    opened.since = time.monotonic()
                except StopIteration:
                    self._open.remove(opened)
            late = time.monotonic() - opened.since > DEADLINE_S
            assert not late, f"{opened.name}: not within {DEADLINE_S:.0f} s: {opened.waits_for}"

    def _until(self, flock: Flock, true: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + DEADLINE_S
        while not true():
            flock.listen(0.02)
            self._go_on()
            assert flock.world.poll() in (None, 0), f"the world ended with {flock.world.poll()}"
            assert time.monotonic() < end, f"not within {DEADLINE_S:.0f} s: {what}"

    # -- the end ----------------------------------------------------------------------------------------------------

    def _promise(self, day: BadDay, flock: Flock) -> None:
        self._nodes_lost = day.lost

    def _end(self, flock: Flock) -> None:
        """Everybody goes home by itself, and what is left is whole."""
        end = time.monotonic() + DEADLINE_S
        going = [flock.world, flock.station, *flock.agents.values(), *flock.leaders.values()]
        while any(process.poll() is None for process in going):
            assert time.monotonic() < end, "not everybody went home"
            flock.listen(0.05)
        self._check({process.returncode for process in going} == {0}, "somebody did not end with exit code 0")
        folders = list(self._out.iterdir())
        assert len(folders) == 1, f"{len(folders)} run folders"
        self._look_at(folders[0], flock)
        self._check("Traceback" not in flock.said(), f"somebody raised: {flock.said()}")

    def _look_at(self, folder: Path, flock: Flock) -> None:
        summary = self.report.summary = json.loads((folder / "summary.json").read_text())
        table = pq.read_table(folder / "timeseries.parquet")
        states = states_of(table)
        calendar = Rounds(flock.scenario)
        rounds = sum(calendar.closes(tick) > 0 for tick in range(self._ticks))
        kinds = Counter(json.loads(line)["kind"] for line in (folder / "events.jsonl").read_text().splitlines())
        for holds, promise in (
            (summary["ticks"] == self._ticks, f"{summary['ticks']} ticks flown"),
            (summary["lost"] == 0, f"{summary['lost']} UAVs lost at the end"),
            (summary["nodes_lost"] == self._nodes_lost, f"{summary['nodes_lost']} nodes lost of {self._nodes_lost}"),
            (summary["rounds"] == rounds, f"{summary['rounds']} rounds averaged of {rounds}"),
            (summary["telemetry_blocks_dropped"] == 0, "telemetry was dropped"),
            (table["tick"].to_pylist() == list(range(self._ticks + 1)), "rows are missing or there twice"),
            (
                hashlib.sha256(states.astype("<f8").tobytes()).hexdigest() == summary["trajectory_sha256"],
                "the rows are not the trajectory",
            ),
            (kinds["finished"] == 1 and kinds["round"] == rounds, f"events: {dict(kinds)}"),
            (kinds == flock.kinds(), f"events kept {dict(kinds)}, told {dict(flock.kinds())}"),
            (verify(folder / "recording.rrd") is None, "the recording is damaged"),
            (not (folder / CHECKPOINT).exists(), "a checkpoint was left behind"),
            (not [p for p in folder.iterdir() if p.name.startswith(".")], "a half-written file was left behind"),
        ):
            self._check(holds, promise)

    def _check(self, holds: bool, promise: str) -> None:
        if not holds:
            self.report.broken.append(promise)
