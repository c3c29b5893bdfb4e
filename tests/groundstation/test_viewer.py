"""Rerun's program: live viewers, pictures and repairs."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import viewer
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.recording.replay import repair, verify
from meanflock.groundstation.recording.viewer import MISSING_GRAPHICS, screenshot
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, BadInput, RunFailed
from meanflock.swarm.scenario import Scenario
from tests.groundstation.recordings import column, flight, record
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.usefixtures("strict")


def test_a_late_viewer_gets_the_history(tmp_path: Path) -> None:
    blocks = flight(uavs=4, ticks=60)
    late = tmp_path / "late.rrd"
    with Recorder(Scenario(uavs=4), "test", tmp_path / "own.rrd", serve=("localhost", 0)) as recorder:
        assert recorder.live_url is not None
        assert "://127.0.0.1:" in recorder.live_url or "://[::1]:" in recorder.live_url
        for block in blocks:
            recorder.write(block)
        recorder.flush()
        listener = save_live(recorder.live_url, late)
        try:
            until(
                lambda: listener.poll() is not None or len(ticks_so_far(late)) == 60, "the history at the late viewer"
            )
            assert listener.poll() is None, "it ended by itself"
        finally:
            listener.terminate()
            listener.wait(DEADLINE_S)
    assert verify(tmp_path / "own.rrd") is None
    np.testing.assert_array_equal(ticks_so_far(late), np.arange(60))


def ticks_so_far(growing: Path) -> np.ndarray:
    """The ticks in a recording that another process may still write."""
    if not growing.exists():
        return np.array([])
    read = growing.with_name(f"read.{growing.name}")
    shutil.copyfile(growing, read)
    try:
        repair(read)
        return column(read, look.UAVS, "Points2D:positions")[0]
    except (RunFailed, ValueError):  # not yet a recording, or only the blueprint has come
        return np.array([])
    finally:
        read.unlink()


def test_a_file_that_is_no_recording_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    for use in (viewer.open_viewer, lambda missing: screenshot(missing, tmp_path / "swarm.png", at_s=0.0)):
        with pytest.raises(BadInput, match="no such recording"):
            use(path)
    path.write_bytes(b"not a recording")
    assert verify(path) is not None
    with pytest.raises(RunFailed, match="cannot be repaired"):
        repair(path)
    assert path.read_bytes() == b"not a recording"


def skip_without_graphics(said: str) -> None:
    no_graphics = ("No graphics adapter", "Failed to get render context")  # with and without drivers installed
    if any(reason in said for reason in no_graphics) and MISSING_GRAPHICS in said:
        pytest.skip(said)


@pytest.mark.processes
def test_a_picture_shows_the_given_second_or_the_last_without_a_display(run, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    record(tmp_path / "recording.rrd", flight(ticks=200))
    pictures = {}
    for name, flags in {"middle": ("--at", "10"), "last": ("--at", "19.9"), "default": ()}.items():
        png = tmp_path / "out" / f"{name}.png"
        code, out, err = run("picture", "recording.rrd", *flags, "-o", str(png), "--size", "640x480")
        skip_without_graphics(err)
        assert (code, out) == (EXIT_DONE, f"{png}\n")
        pictures[name] = imread(png)
        assert pictures[name].shape[:2] == (480, 640)
    apart = {name: float(np.abs(pictures[name] - pictures["default"]).mean()) for name in ("last", "middle")}
    assert 10 * apart["last"] < apart["middle"]
    code, _, err = run("picture", "recording.rrd", "--at", "20", "-o", "beyond.png")
    assert code == EXIT_BAD_INPUT
    assert "of 0 to 19.9 s" in err
    assert not (tmp_path / "beyond.png").exists()


def save_live(url: str, path: Path) -> "subprocess.Popen[bytes]":
    """A process that connects like a viewer and writes the recording to a file."""
    return subprocess.Popen(
        [*viewer._program(), url, "--save", str(path)], env=viewer._environment(), stderr=subprocess.DEVNULL
    )
