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

from meanflock.federation.schedule import Schedule
from meanflock.groundstation.recording.replay import verify
from meanflock.groundstation.results.run_folder import CHECKPOINT
from meanflock.groundstation.results.series import states_of
from tests.polling import DEADLINE_S
from tests.soak.mishaps import BadDay, Mishap, Wait
from tests.soak.swarm import BARRIER_S, Flock
from tests.soak.vitals import Vitals

AT_ONCE = 3  # mishaps that are not mended yet
SAMPLE_EVERY_S = 1.0
_LAST_TICKS = 400  # less than an agent needs to start


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
    waits_for: Wait
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
        self._held: int | None = None  # the UAV everybody waits for
        self._held_since = 0.0
        self.report = Report()

    def run(self) -> Report:
        """Flies, hurts, mends, and looks what is left."""
        started = time.monotonic()
        mine = psutil.Process().num_fds()
        with Flock(self._uavs, self._ticks, self._seed, self._out) as flock:
            vitals = Vitals(flock)
            try:
                day = BadDay(flock, self._seed)
                self._assemble(flock, day)
                self._fly(flock, vitals, day)
                self._end(flock, day.lost)
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

    def _assemble(self, flock: Flock, day: BadDay) -> None:
        for _ in range(2):
            self._begin("take-off", day.another_leader())
            self._until(flock, lambda: not self._open, "leaders")
        for uav in range(self._uavs):
            flock.start_agent(uav)
        self._until(flock, lambda: flock.tick > 0, "the first ticks")

    def _fly(self, flock: Flock, vitals: Vitals, day: BadDay) -> None:
        due, sampled = float(self._every), 0.0
        quiet = self._ticks - max(2 * self._every, 160)  # a window of blocks
        while not flock.ended and flock.tick < self._ticks:
            if due <= flock.tick < quiet and len(self._open) < AT_ONCE:
                name, script = day.next()
                self.report.mishaps[name] += 1
                self._begin(name, script)
                due += self._draw.uniform(0.5, 1.5) * self._every
            flock.listen(0.02)
            self._go_on()
            self._hold(flock, day, due)
            if time.monotonic() - sampled > SAMPLE_EVERY_S or (flock.tick >= quiet and not self._open):
                sampled = time.monotonic()
                vitals.sample(all_well=not self._open)
            self._told(flock.tick, ", ".join(o.name for o in self._open))
            assert flock.world.poll() in (None, 0), f"the world ended with {flock.world.poll()}"
        self._release(flock, day)
        self._until(flock, lambda: flock.ended and not self._open, "the end")

    def _hold(self, flock: Flock, day: BadDay, due: float) -> None:
        """Lets the flight wait for processes that start: while too many do for
        another mishap, while one is the station, and before its end.

        It waits for an agent that is frozen, now and then a few ticks are flown, so that nobody is lost for that.
        """
        left = self._ticks - flock.tick
        behind = len(self._open) >= AT_ONCE and due <= flock.tick
        unseen = any(o.name.startswith("station") for o in self._open)  # nobody tells how far the flight is
        wanted = any(o.waits_for.starting for o in self._open) and (behind or unseen or left < _LAST_TICKS)
        now = time.monotonic()
        if self._held is not None and (not wanted or now - self._held_since > BARRIER_S / 3):
            self._release(flock, day)
            flock.listen(0.03)
        elif wanted and self._held is None:
            self._held, self._held_since = day.idle_agent(), now
            day.busy.add(self._held)
            flock.agents[self._held].send_signal(signal.SIGSTOP)

    def _release(self, flock: Flock, day: BadDay) -> None:
        if self._held is not None:
            flock.agents[self._held].send_signal(signal.SIGCONT)
            day.busy.discard(self._held)
            self._held = None

    def _begin(self, name: str, script: Mishap) -> None:
        opened = _Open(name, script, Wait("nothing", lambda: True), time.monotonic())
        self._open.append(opened)
        self._go_on()

    def _go_on(self) -> None:
        """Every mishap whose condition is met takes its next step."""
        for opened in list(self._open):
            if opened.waits_for.met():
                try:
                    opened.waits_for = next(opened.script)
                    opened.since = time.monotonic()
                except StopIteration:
                    self._open.remove(opened)
            late = time.monotonic() - opened.since > DEADLINE_S
            assert not late, f"{opened.name}: not within {DEADLINE_S:.0f} s: {opened.waits_for.what}"

    def _until(self, flock: Flock, true: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + DEADLINE_S
        while not true():
            flock.listen(0.02)
            self._go_on()
            assert flock.world.poll() in (None, 0), f"the world ended with {flock.world.poll()}"
            assert time.monotonic() < end, f"not within {DEADLINE_S:.0f} s: {what}"

    # -- the end ----------------------------------------------------------------------------------------------------

    def _end(self, flock: Flock, nodes_lost: int) -> None:
        """Everybody goes home by itself, and what is left is whole."""
        end = time.monotonic() + DEADLINE_S
        going = [flock.world, flock.station, *flock.agents.values(), *flock.leaders.values()]
        while any(process.poll() is None for process in going):
            assert time.monotonic() < end, "not everybody went home"
            flock.listen(0.05)
        self._check({process.returncode for process in going} == {0}, "somebody did not end with exit code 0")
        folders = list(self._out.iterdir())
        assert len(folders) == 1, f"{len(folders)} run folders"
        kept = sorted(path.name for path in folders[0].iterdir())
        assert "summary.json" in kept, f"no summary, but {kept}; mishaps: {dict(self.report.mishaps)}"
        self._look_at(folders[0], flock, nodes_lost)
        self._check("Traceback" not in flock.said(), f"somebody raised: {flock.said()}")

    def _look_at(self, folder: Path, flock: Flock, nodes_lost: int) -> None:
        summary = self.report.summary = json.loads((folder / "summary.json").read_text())
        table = pq.read_table(folder / "timeseries.parquet")
        states = states_of(table)
        calendar = Schedule(flock.scenario)
        rounds = sum(calendar.closes(tick) > 0 for tick in range(self._ticks))
        events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
        kinds = Counter(event["kind"] for event in events)
        voids = [event["text"] for event in events if " is void: " in event["text"]]
        for holds, promise in (
            (summary["ticks"] == self._ticks, f"{summary['ticks']} ticks flown"),
            (summary["lost"] == 0, f"{summary['lost']} UAVs lost at the end"),
            (summary["nodes_lost"] == nodes_lost, f"{summary['nodes_lost']} nodes lost, {nodes_lost} were hit"),
            (
                summary["rounds"] + summary["rounds_void"] == rounds,
                f"{summary['rounds']} rounds averaged and {summary['rounds_void']} void of {rounds}",
            ),
            (summary["telemetry_blocks_dropped"] == 0, "telemetry was dropped"),
            (table["tick"].to_pylist() == list(range(self._ticks + 1)), "rows are missing or there twice"),
            (
                hashlib.sha256(states.astype("<f8").tobytes()).hexdigest() == summary["trajectory_sha256"],
                "the rows are not the trajectory",
            ),
            (kinds["finished"] == 1 and kinds["round"] == summary["rounds"], f"events: {dict(kinds)}"),
            (
                len(voids) == summary["rounds_void"] and not any("no leader" in text for text in voids),
                f"void rounds: {voids}",
            ),
            (
                flock.kinds() == kinds if flock.finished else flock.kinds() <= kinds,
                f"events kept {dict(kinds)}, told {dict(flock.kinds())}",
            ),
            (verify(folder / "recording.rrd") is None, "the recording is damaged"),
            (not (folder / CHECKPOINT).exists(), "a checkpoint was left behind"),
            (not [p for p in folder.iterdir() if p.name.startswith(".")], "a half-written file was left behind"),
        ):
            self._check(holds, promise)

    def _check(self, holds: bool, promise: str) -> None:
        if not holds:
            self.report.broken.append(promise)
