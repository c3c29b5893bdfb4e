"""Disk space of a run folder: the estimate before take-off, and what is refused."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.disk import LARGE_SWARM, needed_mb
from meanflock.swarm.scenario import load


@pytest.mark.parametrize("uavs", [25, LARGE_SWARM + 1])
def test_a_run_folder_takes_no_more_than_the_estimate_and_a_large_recording_is_announced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], uavs: int
) -> None:
    settings = [f"uavs={uavs}", "stop=duration", "duration=40", "federation.period=50"]
    flags = [word for setting in settings for word in ("--set", setting)]
    assert main(["run", "--in-process", "--out", str(tmp_path), *flags]) == 0
    told = "positions of every 5th tick" in capsys.readouterr().err
    assert told == (uavs > LARGE_SWARM)
    flown, size = load(None, settings), sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    assert size <= needed_mb(flown, record=True) * 1e6 <= 2 * size + 4e6


@pytest.mark.parametrize(
    ("free_mb", "flags", "remedy"),
    [
        (80, (), "fly without the recording: --no-record"),
        (40, (), "a shorter flight: --duration S"),
        (40, ("--no-record",), "--out DIR"),
    ],
)
def test_a_run_that_would_not_fit_on_the_disk_is_refused_with_the_estimate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, free_mb, flags, remedy
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free_mb * 10**6))
    folder = tmp_path / "new" / "runs"
    assert main(["run", "--in-process", "--uavs", "200", "--out", str(folder), *flags]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    most = needed_mb(load(None, ["uavs=200"]), record=not flags)
    assert line.startswith(f"error: disk: up to {most} MB for 200 UAVs over ")
    assert f"{free_mb} MB free" in line
    assert remedy in line
    assert not folder.parent.exists()
