"""Files that are deleted in flight: the command ends with 1 and names them, and never a command whose file is gone."""

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.cli.command import main
from meanflock.launch.engine import Engine
from meanflock.launch.options import FlightOptions
from meanflock.launch.outputs import Outputs
from meanflock.results.run_folder import CHECKPOINT, RunFolder, completed, go_on
from meanflock.results.timeseries_file import SPOOL
from meanflock.swarm import durable
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, BadInput, RunFailed
from meanflock.swarm.plugins import load_file
from tests.polling import until

FLIGHT = {"method": "plan", "uavs": 3, "duration": 30.0, "stop": "duration"}
STAYS = ["events.jsonl", "recording.rrd", "scenario.toml", "summary.json", "timeseries.parquet"]


def flown(out: Path, at_tick_200: Callable[[Path], object], record: bool = False) -> Path:
    """The folder of a flight, changed in tick 200."""
    scenario = mf.Scenario(**FLIGHT)
    with Outputs(scenario, "run", FlightOptions(out, record=record, quiet=True)) as outputs:
        engine = Engine(scenario, "run", sinks=outputs.sinks)
        for tick in engine.fly():
            if tick == 200:
                at_tick_200(outputs.folder.path)
        outputs.summary = engine.finish()
    return outputs.folder.path


@pytest.mark.parametrize(
    ("name", "gone"),
    [
        (".telemetry", ".telemetry, timeseries.parquet"),
        ("events.jsonl", "events.jsonl"),
        ("scenario.toml", "scenario.toml"),
        ("recording.rrd", "recording.rrd"),
    ],
)
@pytest.mark.parametrize("how", ["deleted", "replaced"])
def test_a_file_that_is_deleted_in_flight_is_named_and_the_rest_is_whole(tmp_path, name: str, gone: str, how) -> None:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        if how == "replaced" and name in (".telemetry", "events.jsonl"):
            (folder / name).write_text("of another")

    with pytest.raises(RunFailed) as failed:
        flown(tmp_path, change, record=name == "recording.rrd")
    folder = tmp_path / "run"
    expected = f"{folder}: deleted or renamed during the flight: {gone}; bring back what can be brought back, or fly "
    assert str(failed.value).startswith(expected)
    assert (f"`meanflock run {folder}/scenario.toml`" in str(failed.value)) is (name != "scenario.toml")
    lost = {*gone.split(", "), *(() if name == "recording.rrd" else ("recording.rrd",))}
    assert {path.name for path in folder.iterdir()} - {name} == set(STAYS) - lost
    if how == "replaced" and name in (".telemetry", "events.jsonl"):
        assert (folder / name).read_text() == "of another"


def test_the_copy_of_a_plugin_that_is_deleted_in_flight_is_named(run: Any, tmp_path: Path, monkeypatch) -> None:
    spring = Path(__file__).parents[2] / "examples" / "spring.py"
    finish = RunFolder.summarise

    def summarise(folder: RunFolder, summary: dict[str, Any]) -> None:
        (folder.path / "plugins" / "spring.py").unlink()
        finish(folder, summary)

    monkeypatch.setattr(RunFolder, "summarise", summarise)
    flags = ("--in-process", "--no-record", "--quiet", "--uavs=2", "--duration=1")
    code, _, err = run("run", *flags, "--plugin", str(spring), "--method=spring")
    assert (code, "during the flight: plugins/spring.py; " in err) == (1, True)


@pytest.mark.parametrize("how", ["deleted", "renamed"])
def test_a_folder_that_is_gone_is_named_without_a_command_of_its_files(tmp_path: Path, how: str) -> None:
    def change(folder: Path) -> None:
        if how == "renamed":
            folder.rename(tmp_path / "elsewhere")
        while folder.exists():  # a checkpoint may be written meanwhile
            shutil.rmtree(folder, ignore_errors=True)

    with pytest.raises(RunFailed) as failed:
        flown(tmp_path, change)
    assert str(failed.value) == f"{tmp_path / 'run'}: deleted or renamed during the flight; give the command again"


def test_how_to_go_on_names_files_that_are_there(tmp_path: Path) -> None:
    (tmp_path / CHECKPOINT).touch()
    assert go_on(tmp_path) == f"`meanflock resume {tmp_path}` flies the rest"
    (tmp_path / CHECKPOINT).unlink()
    (tmp_path / "scenario.toml").touch()
    again = f"fly the run again with `meanflock run {tmp_path}/scenario.toml`"
    assert go_on(tmp_path) == f"there is no checkpoint to resume from: {again}"
    spring = Path(__file__).parents[2] / "examples" / "spring.py"
    (tmp_path / "scenario.toml").write_text('method = "spring"')
    assert go_on(tmp_path) == "there is no checkpoint to resume from: fly the run again"
    load_file(spring)
    assert go_on(tmp_path).endswith(f"`meanflock run {tmp_path}/scenario.toml --plugin {spring}`")
    (tmp_path / CHECKPOINT).touch()
    assert go_on(tmp_path) == f"`meanflock resume {tmp_path} --plugin {spring}` flies the rest"
    (tmp_path / CHECKPOINT).unlink()
    (tmp_path / "scenario.toml").unlink()
    assert go_on(tmp_path) == "there is no checkpoint to resume from: fly the run again"


REMEDIES = {
    errno.ENOSPC: "make room",
    errno.EDQUOT: "make room",
    errno.EFBIG: "allow larger files",
    errno.EACCES: "let it be written",
    errno.EROFS: "let it be written",
    errno.ENOENT: "bring back what was deleted or renamed",
    errno.ENOTDIR: "bring back what was deleted or renamed",
    errno.EMFILE: "let more files be open",
    errno.EIO: "check the disk",
    errno.EINVAL: "mend that",
}


@pytest.mark.parametrize("number", REMEDIES)
def test_each_error_of_a_file_has_its_own_advice(tmp_path: Path, monkeypatch, number: int) -> None:
    error = OSError(number, os.strerror(number))
    said = f"{os.strerror(number)}; {REMEDIES[number]}"

    def fails(*_: object) -> None:
        raise error

    def not_written(call: Callable[[], object], then: str) -> None:
        with pytest.raises(RunFailed) as failed:
            call()
        assert f"{said}{then}" in str(failed.value)

    (tmp_path / "run").mkdir()
    (tmp_path / SPOOL).touch()
    with monkeypatch.context() as patched:
        patched.setattr(durable, "replace", fails)
        not_written(lambda: durable.put(tmp_path / "table.csv", b""), " and repeat the command")
    with monkeypatch.context() as patched:
        patched.setattr("meanflock.results.run_folder.recover", fails)
        not_written(lambda: completed(tmp_path), ", then give the command again")
    with monkeypatch.context() as patched, RunFolder(tmp_path, "run", mf.Scenario(**FLIGHT)) as folder:
        patched.setattr(folder, "_append", fails)
        block = mf.fly(**FLIGHT | {"duration": 1.0})._blocks[0]
        said = f"{os.strerror(number)}; it holds nothing of the flight yet: {REMEDIES[number]}"
        not_written(
            lambda: folder.write(block), ", then there is no checkpoint to resume from: fly the run again with "
        )


def test_an_abandoned_stepped_flight_is_not_offered_resume(run: Any, tmp_path: Path) -> None:
    with mf.Stepped(uavs=2, duration=60.0, out=tmp_path) as flight:
        for _ in range(300):
            flight.step(np.zeros((2, 2)))
    (folder,) = tmp_path.iterdir()
    assert sorted(path.name for path in folder.iterdir()) == ["events.jsonl", "scenario.toml", "timeseries.parquet"]
    code, out, _ = run("show", str(folder))
    told = "The flight did not finish. It has no checkpoint, so nothing can fly the rest."
    assert (code, told in " ".join(out.split()), "resume" in out) == (EXIT_DONE, True, False)
    code, _, err = run("diff", str(folder), str(folder))
    assert (code, "has not finished" in err, "`meanflock" in err) == (EXIT_BAD_INPUT, True, False)
    with pytest.raises(
        BadInput, match=r"has not finished: it has no summary\.json; there is no checkpoint to resume from"
    ):
        mf.open(folder)


def test_a_run_with_a_checkpoint_is_offered_resume(run: Any, tmp_path: Path) -> None:
    scenario = mf.Scenario(**FLIGHT)
    with RunFolder(tmp_path, "run", scenario) as folder:
        for tick in Engine(scenario, "run", sinks=[folder], realtime=1e6).fly():
            if tick == 150:
                until((folder.path / CHECKPOINT).exists, "a checkpoint")
                break
    code, out, _ = run("show", str(folder.path))
    assert (code, "`meanflock resume` flies the rest" in " ".join(out.split())) == (EXIT_DONE, True)
    assert main(["resume", str(folder.path), "--in-process", "--quiet", "--no-record"]) == EXIT_DONE
