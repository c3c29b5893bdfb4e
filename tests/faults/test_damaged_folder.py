"""Damaged run folders: each command gives a verdict of one line, and leaves the folder as it was."""

import os
import resource
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.recording import viewer
from meanflock.groundstation.recording.replay import recorded, verify
from meanflock.groundstation.results.run_folder import CHECKPOINT, EVENTS, RECORDING, SUMMARY, read_checkpoint
from meanflock.swarm.errors import BadInput
from tests.commands import COMMAND, ended
from tests.faults.conftest import scenario
from tests.faults.dying import LATER, dead

A_DISPLAY = "WAYLAND_SOCKET", "3"  # as if there were one: nothing is opened on it


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dead(tmp_path_factory.mktemp("killed"), scenario(LATER, method="mfg"), 250)


@pytest.fixture
def folder(killed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(killed, tmp_path / "run"))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("flown")
    short = ("--uavs", "3", "--duration", "15", "--set", "metrics.collision_radius=2", "--seed", "3")
    assert main(["run", "--in-process", "--quiet", "--json", "--out", str(out), *short]) == 0
    (made,) = out.iterdir()
    return made


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
    assert f"meanflock view {path}" in verdict(capsys)
    assert contents(folder) == before
    assert main(["view", str(path)]) == 0  # as it says
    (tmp_path / EVENTS).rename(folder / EVENTS)
    path.write_bytes(before[RECORDING][:1000])
    assert main(["view", str(folder)]) == 0
    assert shown == [path, path]
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
