"""A command that was killed is resumed, on processes or in one."""

import json
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.launch.resume import back
from meanflock.groundstation.recording.replay import recorded, verify
from meanflock.groundstation.results.run_folder import CHECKPOINT
from meanflock.swarm import scenario as scenarios
from tests.faults.conftest import Lab
from tests.polling import DEADLINE_S, until

LONG = ("uavs=4", "seed=7", "duration=120", "stop=duration", "federation.period=40")
FILTER = "filter.kind=ecbf"
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
