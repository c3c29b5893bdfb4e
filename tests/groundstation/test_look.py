"""`view`, `plot` and `picture`: finished and flying runs, with and without a display."""

import socket
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.cli import display
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.recording import viewer
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.recording.replay import recorded, verify
from meanflock.groundstation.results.run_folder import RunFolder
from meanflock.swarm import scenario
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, RunFailed

VERBS = (("view", "--web"), ("plot",), ("picture", "-o", "p.png"), ("resume",), ("export", "--mcap", "r"))
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")


def test_a_run_that_still_flies_is_refused_and_not_completed(run, tmp_path) -> None:
    flown = scenario.load(None, ["duration=4", "stop=duration"], uavs=3)
    with (
        RunFolder(tmp_path, "flying", flown) as folder,
        Recorder(flown, "flying", folder.path / "recording.rrd") as recorder,
    ):
        engine = Engine(flown, "flying", sinks=[folder, recorder])
        for tick in engine.fly():
            for verb in VERBS if tick == 30 else ():
                code, _, err = run(*verb, str(folder.path))
                assert (code, err.count("\n")) == (EXIT_BAD_INPUT, 1)
                assert "still writes this run" in err
        engine.world.finish()
    assert verify(folder.path / "recording.rrd") is None
    assert recorded([folder.path / "recording.rrd"]).ticks[-1] == 40
    assert len(pq.read_table(folder.path / "timeseries.parquet")) == 41


@pytest.fixture
def flown(run, tmp_path) -> Path:
    assert run("run", "--in-process", "--quiet", "--uavs", "2", "--duration", "2")[0] == EXIT_DONE
    (folder,) = (tmp_path / "runs").iterdir()
    return folder


def test_without_a_display_view_fails_and_names_the_commands_that_work(run, tmp_path, monkeypatch, flown) -> None:
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    for at in (None, "127.0.0.1:77", ":77", "elsewhere"):
        if at is not None:
            monkeypatch.setenv("DISPLAY", at)
        code, out, err = run("view", str(flown))
        assert (code, out, err.count("\n")) == (EXIT_RUN_FAILED, "", 1)
        for part in ("no display", f"meanflock picture {flown}", f"meanflock view {flown} --web", at or "DISPLAY"):
            assert part in err
    code, _, err = run("run", "--in-process", "--view", "--uavs", "2", "--duration", "2", "--out", "viewed")
    assert (code, "meanflock picture" in err) == (EXIT_RUN_FAILED, True)
    assert not (tmp_path / "viewed").exists()  # nothing was flown


def test_a_display_that_does_not_answer_is_none(tmp_path, monkeypatch) -> None:
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-7")
    with pytest.raises(RunFailed, match="no server answers at WAYLAND_DISPLAY=wayland-7; instead"):
        display.check("instead")
    with socket.socket(socket.AF_UNIX) as compositor:
        compositor.bind(str(tmp_path / "wayland-7"))
        compositor.listen()
        display.check("instead")


def test_a_viewer_that_ends_with_an_error_is_a_failure(run, monkeypatch, flown) -> None:
    monkeypatch.setattr(display, "check", lambda _: None)
    monkeypatch.setattr(viewer, "_program", lambda: ["false"])
    monkeypatch.setattr("meanflock.groundstation.cli.look._complete", lambda *_: None)
    code, _, err = run("view", str(flown))
    assert (code, "the viewer ended with 1" in err) == (EXIT_RUN_FAILED, True)


def test_a_picture_that_cannot_be_drawn_is_refused(run, tmp_path, flown) -> None:
    (tmp_path / "file").write_text("")
    for flags, says in (
        (("-o", "p.jpg"), ".png"),
        (("-o", "p.png", "--size", "1920"), "WIDTHxHEIGHT"),
        (("-o", "p.png", "--size", "20x-20"), "WIDTHxHEIGHT"),
        (("-o", "file/p.png"), "file/p.png"),
        ((), "-o"),
    ):
        code, _, err = run("picture", str(flown), *flags)
        assert (code, err.count("\n"), says in err) == (EXIT_BAD_INPUT, 1, True)
    code, _, err = run("view", str(tmp_path))
    assert (code, "recording" in err) == (EXIT_BAD_INPUT, True)
    assert not list(tmp_path.rglob("*.png"))
