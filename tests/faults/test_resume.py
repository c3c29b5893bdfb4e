"""A run that died or filled its disk goes on to the end it would have had; of a damaged folder there is a verdict."""

import errno
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow.parquet as pq
import pytest

import meanflock as mf
from meanflock.cli.command import main
from meanflock.launch import engine
from meanflock.launch.engine import Engine
from meanflock.launch.processes import free_endpoint
from meanflock.launch.progress import FlightProgress
from meanflock.launch.resume import back
from meanflock.recording import viewer
from meanflock.recording.replay import recorded, verify
from meanflock.results.event_log import row_of
from meanflock.results.run_folder import CHECKPOINT, EVENTS, RECORDING, SUMMARY, RunFolder, read_checkpoint
from meanflock.results.timeseries_file import SPOOL, past
from meanflock.swarm import plugins
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.events import FlightFailed, FlightFinished
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.worldsim.checkpoint import EVERY_TICKS, SCHEMA
from tests.agent.learning import lines
from tests.commands import COMMAND, ended
from tests.faults.by_hand import ticks_of
from tests.faults.conftest import Lab, honest, scenario
from tests.faults.dying import LATER, dead, events, flight, resumed, steady
from tests.memory_swarm import MemorySwarm
from tests.telemetry import Record, comparable, fly
from tests.testing.good import GoodVehicle


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return flight(tmp_path_factory.mktemp("undisturbed"), scenario(LATER))


def test_a_run_can_die_and_be_resumed_again_and_again(undisturbed: dict[str, Any], tmp_path: Path) -> None:
    flown = scenario(LATER)
    folder = dead(tmp_path / "dead", flown, 130)
    for dies_at in (240, 330):
        dead(folder.parent, flown, dies_at, kept=back(folder))
    assert back(folder).start.tick == 301
    assert steady(resumed(folder)) == steady(undisturbed)
    assert ticks_of(folder) == list(range(351))
    assert [e["tick"] for e in events(folder) if e["kind"] == "resumed"] == [101, 201, 301]


GROUPS: list[dict[str, Any]] = [
    {"name": "most", "count": 3, "method": "orca"},
    {"name": "single", "count": 1},
    {"name": "late", "count": 2, "method": "vasarhelyi", "joins_at_s": 20.0},
]


@pytest.mark.parametrize("kind", ["none", "ecbf"])
def test_a_run_is_resumed_before_a_group_joins_and_though_one_has_a_single_uav(kind: str, tmp_path: Path) -> None:
    flown = Scenario(uavs=6, duration=30.0, federation={"leader": 3}, filter={"kind": kind}, groups=GROUPS)
    whole = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 130)
    assert steady(resumed(folder)) == steady(whole)
    assert [group["closest_approach_m"] is None for group in whole["groups"].values()] == [False, True, False]


def test_a_leader_that_was_lost_stays_lost_in_a_resumed_flight_without_rounds() -> None:
    losses = [{"kind": "leader-loss", "tick": tick} for tick in (5, 150)]
    flown = Scenario(uavs=2, duration=20.0, method="straight", stop="duration", faults=losses)
    with patch.object(engine, "_CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS):
        _, whole = fly(flown)
    begin = whole.checkpoints[-1]
    assert begin.tick == 101
    _, rest = fly(flown, resume=begin)
    assert comparable(rest.events) == comparable(whole.events_from(begin.block + 1))


class Stopping(GoodVehicle):
    """A vehicle that fails in the tick of its option."""

    name = "stopping"

    class Options(mf.Options, frozen=True):
        tick: int = 0

    def init(self, uavs: int) -> Any:
        return {**super().init(uavs), "ticks": np.zeros((uavs, 1))}

    def step(self, states: Any, hidden: Any, acceleration: Any, noise: Any) -> Any:
        if hidden["ticks"].max() >= self.options.tick:
            raise ValueError("it stops")
        moved, thrust = super().step(states, hidden, acceleration, noise)
        return moved, {**thrust, "ticks": hidden["ticks"] + 1}


@pytest.mark.parametrize("form", [Engine, MemorySwarm])
@pytest.mark.parametrize("tick", [0, 1, 2, 100, 101, 102, 201, 202])  # checkpoints go on from ticks 1, 101 and 201
def test_a_flight_that_fails_keeps_all_rows_and_says_so_in_its_last_event(tick, form, monkeypatch) -> None:
    monkeypatch.setattr(engine, "_CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
    options = {"vehicle.model": plugins.register(Stopping).name, "vehicle.options": {"tick": tick}}
    flown = Scenario().replace(uavs=2, duration=30.0, stop="duration", method="orca", **options)
    record = Record()
    flight = form(flown, "fails", sinks=[record])
    with pytest.raises(RunFailed, match="it stops"):
        for _ in flight.fly():
            pass
    last = record.events[-1]
    assert (last.tick, type(last)) == (tick, FlightFailed)
    assert sum(len(block.states) for block in record.blocks) == tick + 1
    assert all(begin.tick < max(tick, 1) for begin in record.checkpoints)


def test_a_spool_cut_off_in_the_middle_of_a_block_is_resumed_all_the_same(undisturbed, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("meanflock.launch.engine._BLOCK_ROWS", 20)  # some since the checkpoint
    flown = scenario(LATER)
    folder = dead(tmp_path / "dead", flown, 250)
    spool = folder / ".telemetry"
    os.truncate(spool, spool.stat().st_size - 1000)
    with (folder / "events.jsonl").open("a") as file:
        file.write('{"tick": 2')
    (folder / f".{CHECKPOINT}.0123abcd.part").write_bytes((folder / CHECKPOINT).read_bytes()[:99])  # the next one
    assert resumed(folder)["trajectory_sha256"] == undisturbed["trajectory_sha256"]
    assert all(event["tick"] <= 350 for event in events(folder))
    assert not list(folder.glob(".*"))


@pytest.mark.parametrize("last", [201, 250])  # the tick of a checkpoint, and another
def test_an_interrupted_run_that_has_its_summary_goes_on_too(
    last: int, undisturbed: dict[str, Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    flown = scenario(LATER)
    folder = RunFolder(tmp_path / "dead", "run", flown)
    engine = Engine(flown, "run", sinks=[folder, FlightProgress(flown, quiet=True)])
    for tick in engine.fly():
        if tick == last:
            break
    with folder:
        folder.summarise(engine.finish())
    assert not caplog.records
    assert (folder.path / "timeseries.parquet").exists()
    assert "finished" not in [event["kind"] for event in events(folder.path)]
    assert steady(resumed(folder.path)) == steady(undisturbed)
    assert [event["kind"] for event in events(folder.path)].count("finished") == 1


def shipped(name: str, *settings: str) -> Scenario:
    """A shipped scenario, for 250 ticks."""
    path = Path(__file__).parents[2] / "scenarios" / f"{name}.toml"
    return scenarios.load(path, ("duration=25", "stop=duration", *settings))


SUBJECTS: dict[str, Callable[[], Scenario]] = {
    "groups": lambda: shipped("groups", "federation.period=25"),
    "batteries and landings": lambda: shipped("patrol"),
    "a station, by TDMA": lambda: shipped("mast", "federation.period=20", "uavs=6"),
    "fragments and retries": lambda: shipped("lossy", "federation.period=25", "federation.retries=2", "uavs=4"),
    "quadrotors": lambda: shipped("sphere", "vehicle.model=quadrotor", "uavs=4", "federation.period=20"),
    "a fault script": lambda: shipped("faults"),
    "a learner": lambda: lines.scenario(duration=25.0),
}
TABLES = ("rounds.parquet", "timeseries.parquet")


@pytest.mark.parametrize("subject", SUBJECTS)
def test_each_file_of_a_resumed_run_is_that_of_an_undisturbed_one(subject: str, tmp_path: Path) -> None:
    flown = SUBJECTS[subject]()
    summary = flight(tmp_path / "whole", flown)
    whole, folder = tmp_path / "whole" / "run", dead(tmp_path / "dead", flown, 170)
    kept = back(folder)
    assert kept.start.tick in (1, 101)  # none while UAVs are paused
    assert steady(flight(folder.parent, flown, kept=kept)) == steady(summary)
    assert events(folder, "resumed") == events(whole)
    files = sorted(path.name for path in whole.iterdir())
    assert sorted(path.name for path in folder.iterdir()) == files
    for name in {*TABLES} & {*files}:
        assert pq.read_table(folder / name).equals(pq.read_table(whole / name)), name


def test_while_some_are_paused_no_checkpoint_is_taken_that_would_lack_their_minds() -> None:
    lab = Lab(scenario('faults=[{kind="pause", tick=95, duration_s=1.0, uavs=[1]}]'))
    lab.fly()
    assert [block.first_tick for block in lab.record.blocks if block.checkpoint] == [0]


def test_a_run_whose_uavs_were_all_lost_is_resumed(tmp_path: Path) -> None:
    lost = scenario("faults=[{kind='kill',tick=30,uavs=[0,1,2,3,4,5]}]", LATER, "method=windmap")
    whole = flight(tmp_path / "whole", lost)
    assert steady(resumed(dead(tmp_path / "dies", lost, 150))) == steady(whole)


A_DISPLAY = "WAYLAND_SOCKET", "3"  # as if there were one: nothing is opened on it


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dead(tmp_path_factory.mktemp("killed"), scenario(LATER, method="mfg"), 250)


@pytest.fixture
def folder(killed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(killed, tmp_path / "run"))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with_events = {"metrics.collision_radius": 2.0}
    return mf.fly(uavs=3, duration=15, seed=3, out=tmp_path_factory.mktemp("flown"), record=True, **with_events).folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def verdict(capsys: pytest.CaptureFixture[str]) -> str:
    said = capsys.readouterr().err.strip()
    assert said.startswith("error: "), said
    assert "\n" not in said
    return said


def test_a_flipped_bit_of_a_checkpoint_is_noticed_wherever_it_is(folder: Path) -> None:
    path = folder / CHECKPOINT
    whole = path.read_bytes()
    read_checkpoint(folder)
    for place in {*range(0, len(whole), 61), *range(80), *range(len(whole) - 80, len(whole))}:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :])
        with pytest.raises(BadInput, match=r"checkpoint\.msgpack: damaged"):
            read_checkpoint(folder)


Damage = Callable[[Path], object]


def changed(name: str, change: Callable[[bytes], bytes]) -> Damage:
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def over(folder: Path) -> None:
    """Lets the flight end: no checkpoint, a summary, and the event."""
    (folder / CHECKPOINT).rename(folder / SUMMARY)
    with (folder / EVENTS).open("a") as events:
        events.write(json.dumps(row_of(FlightFinished(300, 2, 6), 0.1)) + "\n")


def of_another_version(folder: Path) -> None:
    """Gives a folder a checkpoint and rows that another version wrote."""
    saved = read_checkpoint(folder)
    body = control.encode_record({**control.decode_record(saved["body"]), "schema": SCHEMA - 1})
    record = control.encode_record({**saved, "body": body})
    whole = {"sha256": hashlib.sha256(record).digest(), "record": record}
    (folder / CHECKPOINT).write_bytes(control.encode_record(whole))
    (folder / SPOOL).write_bytes(b"rows of another form")


DAMAGES: dict[str, tuple[Damage, str]] = {  # what happened to a folder, and a part of the verdict
    "no checkpoint": (lambda folder: (folder / CHECKPOINT).unlink(), "there is no checkpoint to resume from"),
    "half a checkpoint": (changed(CHECKPOINT, lambda content: content[:-7]), "meanflock run"),
    "a time series cut off": (changed(".telemetry", lambda content: content[: len(content) // 3]), "missing"),
    "an empty scenario": (changed("scenario.toml", lambda content: b""), "not the scenario that was flown"),
    "another seed": (
        changed("scenario.toml", lambda content: content.replace(b"\nseed = ", b"\nseed = 1")),
        "not the scenario that was flown",
    ),
    "no events": (lambda folder: (folder / EVENTS).unlink(), EVENTS),
    "events cut off": (changed(EVENTS, lambda content: content[:-1]), EVENTS),
    "events that are not JSON": (changed(EVENTS, lambda content: b"\xff garbage\n" * 500), EVENTS),
    "a UAV of another swarm": (
        changed(EVENTS, lambda content: b'{"tick": 1, "kind": "x", "text": "x", "uavs": [77]}' + b"\n" * 5000),
        EVENTS,
    ),
    "no checkpoint but a summary": (
        lambda folder: (folder / CHECKPOINT).rename(folder / SUMMARY),
        "there is no checkpoint to resume from",
    ),
    "the end of a flight": (over, "finished"),
    "a folder of another version": (of_another_version, "resume the run with the version that flew it"),
    "no scenario": (lambda folder: (folder / "scenario.toml").unlink(), "no run"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_run_is_not_resumed_and_its_folder_is_left_as_it_was(name: str, folder, capsys) -> None:
    damage, part = DAMAGES[name]
    damage(folder)
    (folder / RECORDING).write_bytes(b"as it was")
    before = contents(folder)
    assert main(["resume", str(folder), "--quiet", "--in-process"]) == 2
    assert part in verdict(capsys)
    assert contents(folder) == before


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    opened: list[Path] = []
    monkeypatch.setenv(*A_DISPLAY)
    monkeypatch.setattr(viewer, "open_viewer", opened.append)
    monkeypatch.setattr(viewer, "attend", lambda _shown: None)
    return opened


def test_a_recording_cut_off_early_is_made_anew_if_the_folder_has_its_events(flown, tmp_path, shown, capsys) -> None:
    folder = Path(shutil.copytree(flown, tmp_path / "run"))
    path = folder / RECORDING
    path.write_bytes(path.read_bytes()[:200_000])
    (folder / EVENTS).rename(tmp_path / EVENTS)
    before = contents(folder)
    assert main(["view", str(folder)]) == 2
    assert f"{folder / EVENTS}: No such file or directory; bring the file back" in verdict(capsys)
    assert main(["view", str(path)]) == 2
    assert f"{path}: cut off or damaged; name the folder of its run" in verdict(capsys)
    assert contents(folder) == before
    (tmp_path / EVENTS).rename(folder / EVENTS)
    for name in ("scenario.toml", "timeseries.parquet"):
        (folder / name).rename(tmp_path / name)
        assert main(["view", str(folder)]) == 2
        assert f"{path}: cut off or damaged; to complete it, bring back what is missing: {folder}" in verdict(capsys)
        (tmp_path / name).rename(folder / name)
    path.write_bytes(before[RECORDING][:1000])
    assert main(["view", str(folder)]) == 0
    assert shown == [path]
    assert verify(path) is None
    assert recorded([path]).ticks.tolist() == list(range(151))


@pytest.mark.parametrize("command", ["plot", "view"])
def test_a_full_disk_is_a_verdict_and_leaves_nothing_half_written(command: str, folder: Path, flown: Path) -> None:
    if command == "plot":
        folder = flown
    else:
        (folder / RECORDING).write_bytes(b"")
    before = contents(folder)
    full = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (20_000, 20_000))
    done = ended(*COMMAND, command, folder, env=os.environ | dict([A_DISPLAY]), preexec_fn=full)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert contents(folder) == before
    assert not list((folder / "plots").glob("*"))


FULL_BYTES = 320 * 1024
SETTINGS = ("uavs=4", "seed=7", "stop=duration", "duration=80", "federation.period=40")


@pytest.mark.processes
def test_a_run_whose_disk_fills_up_fails_with_a_verdict_and_is_resumed_to_the_same_end(tmp_path: Path) -> None:
    flags = ["--in-process", "--quiet", "--no-record"]
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    limits = FULL_BYTES, resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    full = partial(resource.setrlimit, resource.RLIMIT_FSIZE, limits)
    failed = ended(*COMMAND, "run", "--out", str(tmp_path), *flags, *settings, preexec_fn=full)
    (folder,) = tmp_path.iterdir()
    so_far = past(folder)
    rows = so_far.rows.num_rows
    assert (failed.returncode, "Traceback" in failed.stderr) == (1, False)
    verdict = failed.stderr.splitlines()[-1]
    assert verdict.startswith(f"error: {folder}: File too large; ")
    assert f"up to tick {rows - 1}:" in verdict
    assert f"meanflock resume {folder}" in verdict
    assert so_far.events_bytes == (folder / EVENTS).stat().st_size
    assert not list(folder.glob("*.part"))
    assert 20 < rows < 800
    assert main(["resume", str(folder), *flags]) == 0
    expected = honest(scenarios.load(None, SETTINGS))
    assert json.loads((folder / "summary.json").read_text())["trajectory_sha256"] == expected
    assert ticks_of(folder) == list(range(801))


def test_a_run_without_room_is_bad_input_and_changes_nothing(tmp_path, monkeypatch, capsys) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = dead(tmp_path, scenario(LATER, method="mfg"), 150)
    monkeypatch.setattr("meanflock.results.run_folder.Spool", full)
    with pytest.raises(BadInput, match="No space left"):
        RunFolder(tmp_path, "another", scenario())
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert main(["resume", str(folder), "--in-process", "--quiet"]) == 2
    assert capsys.readouterr().err.startswith(f"error: {folder}: No space left on device; make room")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_an_output_that_takes_no_more_is_an_error_in_a_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = ended(*COMMAND, "scenario", "show", capture_output=False, stdout=full, stderr=subprocess.PIPE)
    assert done.stderr == "error: standard output: No space left on device; what was flown or written is kept\n"
    assert done.returncode == 1


@pytest.mark.parametrize(
    ("command", "code", "says"),
    [
        (("cli", "scenario", "show"), 0, ""),
        (("worldsim", "--endpoint", "ENDPOINT", "--run", "mute", "--wait", "0.1"), 1, "the swarm still waits for "),
    ],
)
def test_a_process_whose_output_is_closed_ends_as_any_other(command: tuple[str, ...], code: int, says: str) -> None:
    module, *flags = (word.replace("ENDPOINT", free_endpoint()) for word in command)
    done = ended("sh", "-c", '"$@" >&-', "sh", sys.executable, "-m", f"meanflock.{module}", *flags)
    assert (done.returncode, done.stderr.count("\n")) == (code, code)
    assert says in done.stderr
