"""Run folders that were damaged: whoever opens one gets a verdict in a line, not other numbers and not a traceback."""

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import meanflock as mf
from meanflock.groundstation.cli.command import main
from meanflock.groundstation.plots.run import plot_run
from meanflock.groundstation.recording import viewer
from meanflock.groundstation.recording.replay import recorded, verify
from meanflock.groundstation.results.run_folder import CHECKPOINT, EVENTS, RECORDING, read_checkpoint
from meanflock.swarm.errors import BadInput
from tests.faults.conftest import scenario
from tests.faults.dying import LATER, dead, resumed
from tests.polling import DEADLINE_S

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


@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "not a record"])
def test_a_damaged_checkpoint_is_a_verdict_and_nothing_changes(
    damage: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / CHECKPOINT
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 0x10
    path.write_bytes({"flipped": bytes(whole), "cut": whole[:-7], "empty": b"", "not a record": b"\x93\1\2\3"}[damage])
    before = contents(folder)
    assert main(["resume", str(folder), "--in-process", "--quiet"]) == 2
    assert "meanflock run" in verdict(capsys)
    assert contents(folder) == before


EVENT = b'{"tick": 1, "kind": "x", "text": "x", "uavs": []}'
DAMAGED_EVENTS = {
    "empty": b"",
    "garbage": b"\xff garbage\n" * 500,
    "no JSON": b"garbage\n" * 500,
    "another kind of rows": b"[1]\n" * 1000,
    "endless": EVENT.replace(b"1", b"Infinity") + b"\n" * 5000,
    "of another swarm": EVENT.replace(b"[]", b"[77]") + b"\n" * 5000,
}


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("damage", ["missing", "cut", *DAMAGED_EVENTS])
def test_a_run_whose_events_are_gone_or_damaged_is_not_resumed_and_nothing_changes(
    damage: str, recorded: bool, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / EVENTS
    kept = path.read_bytes()
    path.unlink() if damage == "missing" else path.write_bytes(DAMAGED_EVENTS.get(damage, kept[:-1]))
    (folder / RECORDING).write_bytes(b"as it was")
    before = contents(folder)
    flags = ("--record",) if recorded else ("--no-record",)
    assert main(["resume", str(folder), "--in-process", "--quiet", *flags]) == 2
    assert EVENTS in verdict(capsys)
    assert contents(folder) == before
    path.write_bytes(kept)
    assert resumed(folder)["ticks"] == 350


@pytest.mark.parametrize(
    "content", [None, b"", b"\0\0\0\n[1]\n{}\n", b'{"tick": 9999, "kind": "collision", "uavs": [77]}\n']
)
def test_a_plot_without_events_counts_the_collisions_all_the_same(
    content: bytes | None, flown: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = Path(shutil.copytree(flown, tmp_path / "run"))
    collisions = json.loads((folder / "summary.json").read_text())["collisions"]
    assert collisions > 0
    (folder / EVENTS).unlink() if content is None else (folder / EVENTS).write_bytes(content)
    if content is None:
        assert main(["plot", str(folder)]) == 0
        assert f"collisions: {collisions}" in (folder / "plots" / "paths.svg").read_text()
    else:  # what is drawn is written like any other
        (legend,) = plot_run(folder)["paths"].legends
        assert f"collisions: {collisions}" in [text.get_text() for text in legend.get_texts()]
    assert f"0 of {collisions} collisions" in caplog.text


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """What was opened in a viewer, which is none here."""
    opened: list[Path] = []
    monkeypatch.setenv(*A_DISPLAY)
    monkeypatch.setattr(viewer, "open_viewer", opened.append)
    monkeypatch.setattr(viewer, "attend", lambda _shown: None)
    return opened


@pytest.mark.parametrize("size", [0, 10, 1000, 5000, 20_000])
def test_a_recording_cut_off_early_is_made_anew_from_the_time_series(
    size: int, flown: Path, tmp_path: Path, shown: list[Path]
) -> None:
    folder = Path(shutil.copytree(flown, tmp_path / "run"))
    path = folder / RECORDING
    path.write_bytes(path.read_bytes()[:size])
    assert main(["view", str(folder)]) == 0
    assert shown == [path]
    assert verify(path) is None
    assert recorded([path]).ticks.tolist() == list(range(151))


@pytest.mark.parametrize("size", [0, 10, 1000])
def test_a_recording_alone_of_which_nothing_can_be_read_is_a_verdict_and_left_as_it_was(
    size: int, flown: Path, tmp_path: Path, shown: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / RECORDING
    path.write_bytes((flown / RECORDING).read_bytes()[:size])
    before = path.read_bytes()
    assert main(["view", str(path)]) == 1
    assert str(path) in verdict(capsys)
    assert path.read_bytes() == before
    assert not shown


@pytest.mark.parametrize("content", [None, b""])
def test_a_recording_that_cannot_be_completed_without_events_is_a_verdict(
    content: bytes | None, flown: Path, tmp_path: Path, shown: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(flown, tmp_path / "run"))
    (folder / RECORDING).write_bytes((folder / RECORDING).read_bytes()[:200_000])
    (folder / EVENTS).unlink() if content is None else (folder / EVENTS).write_bytes(content)
    before = contents(folder)
    assert main(["view", str(folder)]) == 2
    assert f"meanflock view {folder / RECORDING}" in verdict(capsys)
    assert contents(folder) == before
    assert main(["view", str(folder / RECORDING)]) == 0  # as it says
    assert shown == [folder / RECORDING]


@pytest.mark.parametrize("command", ["plot", "view"])
def test_a_full_disk_is_a_verdict_and_leaves_nothing_half_written(command: str, folder: Path) -> None:
    before = contents(folder)
    (folder / RECORDING).write_bytes(b"")
    program = "import sys; from meanflock.groundstation.cli.command import main; "
    program += f"sys.exit(main([{command!r}, {str(folder)!r}]))"
    limit = 20_000  # bytes a file may have; a time series has more
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        env=os.environ | dict([A_DISPLAY]),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert done.stderr.strip().count("\n") == 0
    assert "make room" in done.stderr
    assert contents(folder) == before | {RECORDING: b""}


def test_a_picture_is_whole_or_not_there(flown: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(flown, tmp_path / "run"))
    program = "import sys; from meanflock.groundstation.cli.command import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", program, "plot", str(folder)],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
    )
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert done.stderr.strip().count("\n") == 0
    assert not list((folder / "plots").iterdir())


@pytest.mark.parametrize("how", ["empty", "another seed"])
@pytest.mark.parametrize("flags", [(), ("--in-process",)])
def test_another_scenario_than_was_flown_is_refused_and_its_folder_left_as_it_was(
    how: str, flags: tuple[str, ...], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "scenario.toml"
    text = path.read_text()
    path.write_text("" if how == "empty" else text.replace("\nseed = ", "\nseed = 1"))
    before = contents(folder)
    assert main(["resume", str(folder), "--quiet", *flags]) == 2
    assert f"{path}: not the scenario that was flown" in verdict(capsys)
    assert contents(folder) == before


def test_events_that_are_damaged_or_gone_are_an_error_of_the_folder(flown: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(flown, tmp_path / "run"))
    (copy / EVENTS).write_bytes(b"junk\n")
    with pytest.raises(BadInput, match=r"events\.jsonl: damaged"):
        _ = mf.open(copy).events
    (copy / EVENTS).unlink()
    with pytest.raises(BadInput, match=r"events\.jsonl: No such file"):
        _ = mf.open(copy).events
    (copy / EVENTS).mkdir()
    assert main(["plot", str(copy)]) == 0
