"""Damaged run folders: each command gives a verdict of one line, and leaves the folder as it was."""

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import meanflock as mf
from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.recording import viewer
from meanflock.groundstation.recording.replay import recorded, verify
from meanflock.groundstation.results.run_folder import (
    CHECKPOINT,
    EVENTS,
    RECORDING,
    SUMMARY,
    RunFolder,
    read_checkpoint,
)
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from tests.faults.conftest import scenario
from tests.faults.dying import LATER, dead
from tests.polling import DEADLINE_S

SPRING = Path(__file__).parents[2] / "examples" / "spring.py"
A_DISPLAY = "WAYLAND_SOCKET", "3"  # as if there were one: nothing is opened on it


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that was killed after its third checkpoint."""
    return dead(tmp_path_factory.mktemp("killed"), scenario(LATER, method="mfg"), 250)


@pytest.fixture
def folder(killed: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(killed, tmp_path / "run"))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that was recorded to its end."""
    out = tmp_path_factory.mktemp("flown")
    short = ("--uavs", "3", "--duration", "15", "--set", "metrics.collision_radius=2", "--seed", "3")
    assert main(["run", "--in-process", "--quiet", "--json", "--out", str(out), *short]) == 0
    (made,) = out.iterdir()
    return made


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def verdict(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
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
    """A file of the folder gets other content."""
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def flipped(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 0x10]) + content[middle + 1 :]


DAMAGES: dict[str, tuple[Damage, str]] = {  # what happened to a folder, and a part of the verdict
    "no checkpoint": (lambda folder: (folder / CHECKPOINT).unlink(), "hundred ticks"),
    "a flipped bit in the checkpoint": (changed(CHECKPOINT, flipped), "meanflock run"),
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
    "no checkpoint but a summary": (lambda folder: (folder / CHECKPOINT).rename(folder / SUMMARY), "finished"),
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


def test_a_run_that_is_still_being_written_is_not_resumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flown = scenario(LATER)
    engine = Engine(flown, "run", sinks=[folder := RunFolder(tmp_path, "run", flown)])
    for tick in engine.fly():
        if tick == 150:
            break
    folder._background.wait()  # a checkpoint is written beside the flight
    before = contents(tmp_path / "run")
    assert main(["resume", str(tmp_path / "run"), "--in-process", "--no-record", "--quiet"]) == 2
    verdict(capsys)
    assert contents(tmp_path / "run") == before
    with folder:
        pass


def test_a_run_whose_plugin_was_changed_names_the_copy_that_flew(tmp_path, capsys) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(SPRING.read_text(encoding="utf-8"), encoding="utf-8")
    plugins.load_file(mine)
    folder = dead(tmp_path / "runs", scenario(LATER, method="spring"), 150)
    mine.write_text(SPRING.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert main(["resume", str(folder), "--no-record", "--quiet", "--plugin", str(mine)]) == 2
    error = verdict(capsys)
    copy = str(folder / "plugins" / "mine.py")
    assert f"controller 'spring' of {plugins.fingerprint(Path(copy).read_bytes())}; here it is of " in error
    assert error.endswith(f"meanflock resume {folder} --plugin {copy}")


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The paths that a viewer would have opened."""
    opened: list[Path] = []
    monkeypatch.setenv(*A_DISPLAY)
    monkeypatch.setattr(viewer, "open_viewer", opened.append)
    monkeypatch.setattr(viewer, "attend", lambda _shown: None)
    return opened


def test_a_recording_cut_off_early_is_made_anew_from_the_time_series(flown, tmp_path, shown) -> None:
    folder = Path(shutil.copytree(flown, tmp_path / "run"))
    path = folder / RECORDING
    path.write_bytes(path.read_bytes()[:1000])
    assert main(["view", str(folder)]) == 0
    assert shown == [path]
    assert verify(path) is None
    assert recorded([path]).ticks.tolist() == list(range(151))


def test_a_recording_that_cannot_be_completed_without_events_is_a_verdict(flown, tmp_path, shown, capsys) -> None:
    folder = Path(shutil.copytree(flown, tmp_path / "run"))
    (folder / RECORDING).write_bytes((folder / RECORDING).read_bytes()[:200_000])
    (folder / EVENTS).unlink()
    before = contents(folder)
    assert main(["view", str(folder)]) == 2
    assert f"meanflock view {folder / RECORDING}" in verdict(capsys)
    assert contents(folder) == before
    assert main(["view", str(folder / RECORDING)]) == 0  # as it says
    assert shown == [folder / RECORDING]


@pytest.mark.parametrize("command", ["plot", "view"])
def test_a_full_disk_is_a_verdict_and_leaves_nothing_half_written(command: str, folder: Path, flown: Path) -> None:
    if command == "plot":
        folder = flown
    else:
        (folder / RECORDING).write_bytes(b"")
    before = contents(folder)
    done = subprocess.run(
        [sys.executable, "-m", "meanflock.groundstation.cli", command, str(folder)],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        env=os.environ | dict([A_DISPLAY]),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert contents(folder) == before
    assert not list((folder / "plots").glob("*"))


def test_events_that_are_damaged_or_gone_are_an_error_of_the_folder(flown: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(flown, tmp_path / "run"))
    (copy / EVENTS).write_bytes(b"junk\n")
    with pytest.raises(BadInput, match=r"events\.jsonl: damaged"):
        _ = mf.open(copy).events
    (copy / EVENTS).unlink()
    with pytest.raises(BadInput, match=r"events\.jsonl: No such file"):
        _ = mf.open(copy).events
