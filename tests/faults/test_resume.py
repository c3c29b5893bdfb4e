"""A run that died goes on from its last checkpoint to the end it would have had, bit for bit."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.cli import main
from meanflock.groundstation.engine import Engine
from meanflock.groundstation.recorded import recorded
from meanflock.groundstation.results import CHECKPOINT, RunFolder
from meanflock.groundstation.resume import back
from meanflock.groundstation.series import states_of
from meanflock.groundstation.viewer import verify
from meanflock.swarm import plugins
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from tests.faults.conftest import Lab, scenario
from tests.methods import METHODS
from tests.polling import DEADLINE_S, until

LATER = "duration=35"  # checkpoints in ticks 1, 101, 201 and 301
SPRING = Path(__file__).parents[2] / "examples" / "spring.py"
TIMING = {"wall_time_s", "real_time_factor", "mode"}
FAULTS = """faults=[{kind="pause", tick=190, duration_s=3.0, uavs=[1]}, {kind="kill", tick=60, uavs=[2]},
    {kind="partition", tick=195, duration_s=3.0, uavs=[4]}, {kind="leader-loss", tick=150},
    {kind="kill", tick=290, uavs=[3]}, {kind="leader-loss", tick=255}]""".replace("\n", " ")


class Died(Exception):
    """What ends a flight in the middle of these tests."""


def flight(out: Path, flown: Scenario, dies_at: int | None = None, rows: int | None = None) -> dict[str, Any]:
    """A run into a folder; where it dies, only what is on the disk is left."""
    folder = RunFolder(out, "run", flown)
    engine = Engine(flown, "run", sinks=[folder], uavs_per_node=rows)
    for tick in engine.fly():
        if tick == dies_at:
            folder._background.wait()  # a checkpoint is written beside the flight
            folder._spool = None  # type: ignore[assignment]  # as after kill -9: nothing is completed
            folder._events.close()
            raise Died
    summary = engine.world.finish()
    with folder:
        folder.summarise(summary)
    return json.loads((folder.path / "summary.json").read_text())


def dead(out: Path, flown: Scenario, at: int, rows: int | None = None) -> Path:
    with pytest.raises(Died):
        flight(out, flown, at, rows)
    return out / "run"


def resumed(folder: Path, *flags: str) -> dict[str, Any]:
    assert main(["resume", str(folder), "--in-process", "--no-record", "--quiet", "--json", *flags]) == 0
    return json.loads((folder / "summary.json").read_text())


def steady(summary: dict[str, Any], *but: str) -> dict[str, Any]:
    return {k: v for k, v in summary.items() if k not in TIMING | set(but)}


def events(folder: Path, *without: str) -> list[Any]:
    told = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    return [event for event in told if event["kind"] not in without]


FILTER = "filter.kind=ecbf"
FLOWN = [
    *((method, ()) for method in (*METHODS, "fed-lspi", "windmap", "orca", "vasarhelyi")),
    *((method, (FILTER,)) for method in ("mfgfl-hf", "plan")),
]


@pytest.mark.parametrize(
    ("method", "settings"), FLOWN, ids=lambda part: part if isinstance(part, str) else "".join(part)
)
def test_every_method_resumes_bit_identically_and_leaves_no_gap_and_no_duplicate(
    method: str, settings: tuple[str, ...], tmp_path: Path
) -> None:
    flown = scenario(LATER, "radio.target_snr_db=76", "radio.coherence_time_s=0.03", *settings, method=method)
    expected = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 287)
    assert back(folder).start.tick == 201
    got = resumed(folder)
    assert steady(got) == steady(expected)
    table, whole = (pq.read_table(f / "timeseries.parquet") for f in (folder, tmp_path / "whole" / "run"))
    assert table["tick"].to_pylist() == list(range(351))
    assert table.equals(whole)
    assert events(folder, "resumed") == events(tmp_path / "whole" / "run")
    assert sorted(p.name for p in folder.iterdir()) == [
        "events.jsonl",
        "scenario.toml",
        "summary.json",
        "timeseries.parquet",
    ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The undisturbed run with faults: its folder and its summary."""
    out = tmp_path_factory.mktemp("whole")
    return out / "run", flight(out, scenario(LATER, FAULTS), rows=2)


@pytest.mark.parametrize("at", [2, 102, 150, 201, 256, 302])
def test_a_run_with_faults_that_dies_anywhere_ends_as_it_would_have(
    at: int, whole: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    expected = whole[1]
    folder = dead(tmp_path / "dead", scenario(LATER, FAULTS), at, rows=3)
    got = resumed(folder, "--uavs-per-process", "4")
    assert steady(got, "wire_bytes", "radio") == steady(expected, "wire_bytes", "radio")
    assert pq.read_table(folder / "timeseries.parquet").equals(pq.read_table(whole[0] / "timeseries.parquet"))
    assert expected["lost"] == 2


def test_states_shared_now_and_then_are_remembered_across_a_resume(tmp_path: Path) -> None:
    flown = scenario(LATER, "federation.state_period=30", method="mfg")
    expected = flight(tmp_path / "whole", flown)
    assert resumed(dead(tmp_path / "dead", flown, 250))["trajectory_sha256"] == expected["trajectory_sha256"]


@pytest.mark.parametrize("broadcast", ["int8", "float32"])
def test_residuals_of_rounded_uploads_are_remembered_across_a_resume(broadcast: str, tmp_path: Path) -> None:
    payload = ("federation.payload=int8", f"federation.broadcast_payload={broadcast}")
    flown = scenario(LATER, "radio.target_snr_db=76", "radio.coherence_time_s=0.03", *payload)
    expected = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 287, rows=2)
    kept = back(folder).start.checkpoint["memory"]["meanflock.residuals"]
    assert kept.shape == (6, 108)
    assert np.abs(kept).max() > 0
    got = resumed(folder, "--uavs-per-process", "4")
    assert steady(got, "wire_bytes", "radio") == steady(expected, "wire_bytes", "radio")


def test_a_run_can_die_and_be_resumed_again_and_again(tmp_path: Path) -> None:
    flown = scenario(LATER)
    expected = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 130)
    for dies_at in (240, 330):
        going_on = back(folder)
        again = RunFolder(folder.parent, "run", flown, going_on.past)
        engine = Engine(flown, "run", sinks=[again], resume=going_on.start)
        for tick in engine.fly():
            if tick == dies_at:
                break
        again._background.wait()
        again._spool = None  # type: ignore[assignment]
        again._events.close()
    assert back(folder).start.tick == 301
    assert steady(resumed(folder)) == steady(expected)
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(351))
    assert [e["tick"] for e in events(folder) if e["kind"] == "resumed"] == [101, 201, 301]


def test_a_spool_cut_off_in_the_middle_of_a_block_is_resumed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.groundstation.engine._BLOCK_ROWS", 20)  # so that there are some since the checkpoint
    flown = scenario(LATER)
    expected = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 250)
    spool = folder / ".telemetry"
    os.truncate(spool, spool.stat().st_size - 1000)
    with (folder / "events.jsonl").open("a") as file:
        file.write('{"tick": 2')
    assert resumed(folder)["trajectory_sha256"] == expected["trajectory_sha256"]
    assert all(event["tick"] <= 350 for event in events(folder))


def test_an_interrupted_run_that_has_its_summary_goes_on_too(tmp_path: Path) -> None:
    flown = scenario(LATER)
    expected = flight(tmp_path / "whole", flown)
    folder = RunFolder(tmp_path / "dead", "run", flown)
    engine = Engine(flown, "run", sinks=[folder])
    for tick in engine.fly():
        if tick == 250:
            break
    with folder:
        folder.summarise(engine.world.finish())
    assert (folder.path / "timeseries.parquet").exists()
    assert steady(resumed(folder.path)) == steady(expected)
    assert [event["kind"] for event in events(folder.path)].count("finished") == 1


def test_the_hash_of_a_resumed_run_is_that_of_all_its_states(tmp_path: Path) -> None:
    import hashlib

    folder = dead(tmp_path, scenario(LATER), 250)
    summary = resumed(folder)
    states = states_of(pq.read_table(folder / "timeseries.parquet"))
    assert hashlib.sha256(states.astype("<f8").tobytes()).hexdigest() == summary["trajectory_sha256"]


def test_a_checkpoint_does_not_alter_the_flight_or_the_rows_of_its_telemetry() -> None:
    runs = []
    for every in (0, 10, 100):
        lab = Lab(scenario())
        lab.world._checkpoint_every = every
        summary = lab.fly()
        runs.append((summary["trajectory_sha256"], np.concatenate([b.states for b in lab.told.blocks]).tobytes()))
        assert sum(bool(block.checkpoint) for block in lab.told.blocks) == {0: 0, 10: 12, 100: 2}[every]
    assert runs[0] == runs[1] == runs[2]


def test_while_some_are_paused_no_checkpoint_is_taken_that_would_lack_their_minds() -> None:
    lab = Lab(scenario('faults=[{kind="pause", tick=95, duration_s=1.0, uavs=[1]}]'))
    lab.fly()
    assert [block.first_tick for block in lab.told.blocks if block.checkpoint] == [0]


def refuses(folder: Path, *parts: str) -> None:
    with pytest.raises(BadInput) as caught:
        back(folder)
    assert len(str(caught.value).splitlines()) == 1
    for part in parts:
        assert part in str(caught.value)


def test_what_cannot_be_resumed_is_bad_input_in_one_line_and_nothing_is_touched(tmp_path: Path) -> None:
    flown = scenario(LATER)
    refuses(tmp_path / "nowhere", "no run")
    flight(tmp_path / "whole", flown)
    refuses(tmp_path / "whole" / "run", "finished", "meanflock run")
    folder = dead(tmp_path / "dead", flown, 150)
    kept = (folder / CHECKPOINT).read_bytes()
    (folder / CHECKPOINT).unlink()
    refuses(folder, CHECKPOINT, "hundred ticks")
    for damage in (kept[:-10], b"", b"\xc1" * 100, kept[: len(kept) // 2] + b"\0" + kept[len(kept) // 2 :]):
        (folder / CHECKPOINT).write_bytes(damage)
        refuses(folder, "resumed")
    (folder / CHECKPOINT).write_bytes(kept)
    spool = folder / ".telemetry"
    rows = spool.read_bytes()
    os.truncate(spool, 9000)
    refuses(folder, "missing")
    spool.write_bytes(rows)
    other = (folder / "scenario.toml").read_text()
    (folder / "scenario.toml").write_text(other.replace("seed = 3", "seed = 4"))
    assert main(["resume", str(folder), "--in-process", "--no-record", "--quiet"]) == 2
    (folder / "scenario.toml").write_text(other)
    assert resumed(folder)["ticks"] == 350


@pytest.mark.parametrize("more", [(), ("--in-process",)])
def test_a_run_whose_plugin_was_changed_since_is_refused_with_the_copy_that_flew(
    more: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(plugins, "_files", dict(plugins._files))
    monkeypatch.setenv(plugins.FILES, "")
    mine = tmp_path / "mine.py"
    mine.write_text(SPRING.read_text(encoding="utf-8"), encoding="utf-8")
    plugins.load_file(mine)
    folder = dead(tmp_path / "runs", scenario(LATER, method="spring"), 150)
    mine.write_text(SPRING.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    line = ["resume", str(folder), "--no-record", "--quiet", *more]
    assert main([*line, "--plugin", str(mine)]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    copy = str(folder / "plugins" / "mine.py")
    assert f"controller 'spring' of {plugins.fingerprint(Path(copy).read_bytes())}; here it is of " in said
    assert said.endswith(f"read the copy of what flew and name that: meanflock resume {folder} --plugin {copy}")


def test_a_run_that_is_still_being_written_is_not_resumed(tmp_path: Path) -> None:
    flown = scenario(LATER)
    folder = RunFolder(tmp_path, "run", flown)
    engine = Engine(flown, "run", sinks=[folder])
    for tick in engine.fly():
        if tick == 150:
            break
    before = (tmp_path / "run" / ".telemetry").stat().st_size
    assert main(["resume", str(tmp_path / "run"), "--in-process", "--no-record", "--quiet"]) == 2
    assert (tmp_path / "run" / ".telemetry").stat().st_size == before
    with folder:
        pass


def test_a_resumed_run_can_be_watched_and_logged_like_any_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = scenario(LATER)
    expected = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 150)
    capsys.readouterr()
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    got = resumed(folder, "--metrics", "0", "--log-format", "json")
    said = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert {(line["run"], line["node"]) for line in said} == {("run", "in-process")}
    assert sum(line["message"].startswith("metrics at http://127.0.0.1:") for line in said) == 1
    assert steady(got) == steady(expected)


def test_a_watch_that_cannot_be_kept_is_bad_input_and_the_run_can_still_be_resumed(tmp_path: Path) -> None:
    folder = dead(tmp_path, scenario(LATER), 150)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = str(server.getsockname()[1])
        for flags in (("--metrics", taken), ("--metrics", "everywhere"), ("--log-format", "xml")):
            assert main(["resume", str(folder), "--in-process", "--quiet", *flags]) == 2
            assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert resumed(folder)["ticks"] == 350


# -- with processes -----------------------------------------------------------------------------------------------

LONG = ("uavs=4", "seed=7", "duration=120", "stop=duration", "federation.period=40")
COMMAND = [sys.executable, "-m", "groundstation.cli"]


def start(out: Path, *flags: str) -> "subprocess.Popen[str]":
    settings_ = [word for setting in LONG for word in ("--set", setting)]
    line = [*COMMAND, "run", "--out", str(out), "--quiet", "--json", *settings_, *flags]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.processes
@pytest.mark.parametrize("setting", [FILTER, "method=orca"])
def test_what_uavs_know_of_each_other_survives_the_death_of_the_command(setting: str, tmp_path: Path) -> None:
    """A filter, and a controller that predicts its neighbours, remember what they heard; nobody says it again."""
    close = ("--set", "start.spacing=2", "--set", setting)
    expected = Lab(scenarios.load(None, [*LONG, "start.spacing=2", setting])).fly()
    process = start(tmp_path, *close, "--no-record")
    checkpoint = until(lambda: list(tmp_path.glob(f"*/{CHECKPOINT}")), "a checkpoint")[0]
    first = checkpoint.stat().st_mtime_ns
    until(lambda: checkpoint.stat().st_mtime_ns != first, "a second checkpoint")
    process.kill()
    process.communicate()
    (folder,) = tmp_path.iterdir()
    assert 101 <= back(folder).start.tick < 1200
    line = [*COMMAND, "resume", str(folder), "--json", "--quiet", "--no-record"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]
    assert {k: summary[k] for k in ("payload_bits", "diagnostics")} == {
        k: expected[k] for k in ("payload_bits", "diagnostics")
    }


@pytest.mark.processes
def test_a_killed_command_is_resumed_on_processes_or_in_one_and_its_recording_is_whole(tmp_path: Path) -> None:
    expected = Lab(scenarios.load(None, LONG)).fly()
    for dies, lives in ((("--in-process",), ()), ((), ("--in-process",))):
        out = tmp_path / "-".join(("run", *dies))
        process = start(out, *dies)
        checkpoint = until(lambda out=out: list(out.glob(f"*/{CHECKPOINT}")), "a checkpoint")[0]
        first = checkpoint.stat().st_mtime_ns
        until(lambda c=checkpoint, f=first: c.stat().st_mtime_ns != f, "a second checkpoint")
        process.kill()
        process.communicate()
        (folder,) = out.iterdir()
        assert 101 <= back(folder).start.tick < 1200
        line = [*COMMAND, "resume", str(folder), "--json", "--quiet", *lives]
        done = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
        assert done.returncode == 0, done.stderr
        summary = json.loads(done.stdout)
        assert summary["trajectory_sha256"] == expected["trajectory_sha256"]
        assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(1201))
        assert verify(folder / "recording.rrd") is None
        assert recorded([folder / "recording.rrd"]).ticks.tolist() == list(range(1201))
        names = {"scenario.toml", "summary.json", "timeseries.parquet", "events.jsonl", "recording.rrd"}
        assert {path.name for path in folder.iterdir()} == names
