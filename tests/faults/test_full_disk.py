"""A disk that fills up in mid-flight: a clear verdict, whole blocks on the disk, and a flight that can go on."""

import errno
import json
import resource
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.groundstation.results.run_folder import RunFolder
from meanflock.groundstation.results.timeseries_file import past
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BadInput
from tests.commands import COMMAND, ended
from tests.faults.conftest import honest, scenario
from tests.faults.dying import LATER, dead

FULL_BYTES = 320 * 1024
SETTINGS = ("uavs=4", "seed=7", "stop=duration", "duration=80", "federation.period=40")


def fill() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (FULL_BYTES, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


def whole(folder: Path) -> int:
    """Looks whether what a folder holds is readable and complete to its last block; how many rows there are."""
    so_far = past(folder)
    assert so_far.rows["tick"].to_pylist() == list(range(so_far.rows.num_rows))
    told = (folder / "events.jsonl").read_bytes()
    assert so_far.events_bytes == len(told)
    for line in told.splitlines():
        json.loads(line)
    assert [path.name for path in folder.iterdir() if path.suffix == ".part"] == []
    return so_far.rows.num_rows


@pytest.mark.processes
def test_a_run_whose_disk_fills_up_fails_with_a_verdict_and_is_resumed_to_the_same_end(tmp_path: Path) -> None:
    flags = ["--in-process", "--quiet", "--no-record"]
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    failed = ended(*COMMAND, "run", "--out", str(tmp_path), *flags, *settings, preexec_fn=fill)
    (folder,) = tmp_path.iterdir()
    assert failed.returncode == 1
    assert "Traceback" not in failed.stderr
    verdict = failed.stderr.splitlines()[-1]
    assert verdict.startswith(f"error: {folder}: ")
    assert "File too large" in verdict
    assert f"meanflock resume {folder}" in verdict
    rows = whole(folder)
    assert f"up to tick {rows - 1}:" in verdict
    assert 20 < rows < 800
    assert main(["resume", str(folder), *flags]) == 0
    expected = honest(scenarios.load(None, SETTINGS))
    assert json.loads((folder / "summary.json").read_text())["trajectory_sha256"] == expected
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(801))


def test_a_run_without_room_is_bad_input_and_changes_nothing(tmp_path, monkeypatch, capsys) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = dead(tmp_path, scenario(LATER, method="mfg"), 150)
    monkeypatch.setattr("meanflock.groundstation.results.run_folder.Spool", full)
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
        (("groundstation.cli", "scenario", "show"), 0, ""),
        (("worldsim", "--endpoint", "ENDPOINT", "--run", "mute", "--wait", "0.1"), 1, "the swarm still waits for "),
    ],
)
def test_a_process_whose_output_is_closed_ends_as_any_other(command: tuple[str, ...], code: int, says: str) -> None:
    module, *flags = (word.replace("ENDPOINT", free_endpoint()) for word in command)
    done = ended("sh", "-c", '"$@" >&-', "sh", sys.executable, "-m", f"meanflock.{module}", *flags)
    assert (done.returncode, done.stderr.count("\n")) == (code, code)
    assert says in done.stderr
