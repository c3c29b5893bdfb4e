"""Which run is the latest: `list` and the name `latest` go by UTC, whatever the clock of the name was."""

import json
import os
import shutil
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from meanflock.cli.command import main
from meanflock.results.run_folder import CHECKPOINT
from meanflock.results.stored_run import began, runs_in
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.groundstation.conftest import QUICK

BEGAN = datetime(2026, 10, 25, 0, 30, tzinfo=UTC)  # the night in which Europe's clocks go back


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run."""
    out = tmp_path_factory.mktemp("flown")
    assert main([*QUICK, "--seed", "1", "--out", str(out)]) == EXIT_DONE
    (folder,) = out.iterdir()
    return folder


def made(flown: Path, at: datetime, zone_h: float, seed: int, *, is_copy: bool = False) -> Path:
    """A run that began at an instant, named by the clock of a time zone; the files of a copy are of now."""
    named = f"{at + timedelta(hours=zone_h):%Y%m%d-%H%M%S}-mfgfl-hf-s{seed}"
    folder = Path(shutil.copytree(flown, Path("runs") / named))
    if not is_copy:
        os.utime(folder / "scenario.toml", (at.timestamp() + 0.4,) * 2)
    return folder


def test_runs_are_sorted_by_utc_whatever_time_zone_named_them(flown: Path, run) -> None:
    zones = (5.75, 2.0, 1.0, -3.5, 0.0)  # each begins later than the one before, by a clock that shows less
    folders = [made(flown, BEGAN + timedelta(minutes=5 * k), zone, k) for k, zone in enumerate(zones)]
    assert [each.folder for each in runs_in(Path("runs"))] == folders[::-1]
    assert [began(each).replace(microsecond=0) for each in folders[:2]] == [BEGAN, BEGAN + timedelta(minutes=5)]
    listed = json.loads(run("list", "--json")[1])
    assert [record["folder"] for record in listed] == [str(each) for each in folders[::-1]]
    assert datetime.fromisoformat(listed[-1]["when"]) == BEGAN
    code, out, err = run("show", "latest", "--json")
    assert (code, json.loads(out)["run_id"], err) == (EXIT_DONE, folders[-1].name, f"latest: {folders[-1]}\n")


def test_a_copied_run_is_named_by_the_clock_of_this_machine(flown: Path, run, monkeypatch) -> None:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    try:
        copied = made(flown, BEGAN - timedelta(hours=8), 2.0, 1, is_copy=True)
        os.utime(copied / "scenario.toml", (BEGAN.timestamp() + 1e6 + 123,) * 2)
        assert began(copied) == BEGAN - timedelta(hours=8)
    finally:
        monkeypatch.undo()
        time.tzset()


def test_latest_is_taken_wherever_a_command_takes_a_run(flown: Path, run, undrawn) -> None:
    old, new = (made(flown, BEGAN + timedelta(minutes=k), 0.0, k) for k in range(2))
    code, out, _ = run("plot", "latest")
    assert (code, out.splitlines()[0]) == (EXIT_DONE, f"{new}/plots/paths.png")
    found = json.loads(run("diff", str(old), "latest", "--json")[1])
    assert (found["a"], found["b"]) == (str(old), str(new))
    assert run("export", "latest", "--mcap", "swarm.mcap")[0] == EXIT_DONE
    for line in (("view", "latest", "--web"), ("picture", "latest", "-o", "x.png")):  # it was not recorded
        code, _, err = run(*line)
        assert (code, f"{new}/recording.rrd: no recording" in err) == (EXIT_BAD_INPUT, True)
    code, _, err = run("bridge", "mavlink", "latest", "--live", "tcp/127.0.0.1:1")
    assert (code, f"latest: {new}" in err) == (EXIT_BAD_INPUT, True)
    old.rename("latest")
    assert json.loads(run("show", "latest", "--json")[1])["folder"] == "latest"


def test_resume_takes_the_latest_run_that_can_be_resumed(flown: Path, run) -> None:
    begun = [made(flown, BEGAN + timedelta(minutes=k), 0.0, k) for k in range(4)]
    for folder in begun[:2]:
        (folder / CHECKPOINT).write_bytes(b"")
    (begun[2] / "summary.json").unlink()  # it did not finish, and has no checkpoint
    code, _, err = run("resume", "latest", "--in-process")
    assert (code, err.splitlines()[0]) == (EXIT_BAD_INPUT, f"latest: {begun[1]}")
    assert f"{begun[1].resolve() / CHECKPOINT}: damaged" in err
    shutil.rmtree("runs")
    code, _, err = run("resume", "latest")
    assert (code, "latest: there is no run that can be resumed in" in err) == (EXIT_BAD_INPUT, True)
    err = run("show", "latest")[2]
    assert "latest: there is no run in" in err
    assert "fly one with `meanflock run`" in err
