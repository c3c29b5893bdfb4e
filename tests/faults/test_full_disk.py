"""A disk that fills up in mid-flight: a clear verdict, whole blocks on the disk, and a flight that can go on."""

import errno
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from io import FileIO
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from msgspec import structs

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.groundstation.recording.replay import verify
from meanflock.groundstation.results.run_folder import RunFolder
from meanflock.groundstation.results.timeseries_file import past
from meanflock.swarm import durable
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BadInput, RunFailed
from tests.faults.conftest import Lab, Processes, scenario, spool_bytes
from tests.faults.dying import LATER, dead
from tests.polling import DEADLINE_S, until

FULL_BYTES = 320 * 1024
SETTINGS = ("uavs=4", "seed=7", "stop=duration", "duration=80", "federation.period=40")
WORDS = ("No space left on device", "File too large")


class Disk:
    """A folder on a disk that is soon full."""

    def __init__(self, path: Path, room: Callable[[], None], limit: Callable[[], None] | None) -> None:
        self.path, self.make_room, self.limit = path, room, limit  # `limit`: called in the process that writes


@pytest.fixture(params=["full", "limited"])
def disk(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Disk]:
    """A file system of its own that is full, where we may make one; and a limit on the size of a file."""
    if request.param == "limited":

        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (FULL_BYTES, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))

        yield Disk(tmp_path, lambda: None, limit)
        return

    def mount(*options: str) -> bool:
        command = ["mount", "-t", "tmpfs", "-o", ",".join(options), "tmpfs", str(tmp_path)]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0

    if os.geteuid() != 0 or not mount(f"size={FULL_BYTES}"):
        pytest.skip("may not mount a file system")
    yield Disk(tmp_path, lambda: None if mount("remount", "size=50m") else pytest.fail("cannot remount"), None)
    subprocess.run(["umount", "-l", str(tmp_path)], check=True)


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
def test_a_run_whose_disk_fills_up_fails_with_a_verdict_and_is_resumed_to_the_end_it_would_have_had(
    disk: Disk,
) -> None:
    recorded = disk.limit is None
    flags = ["--in-process", "--quiet", "--record" if recorded else "--no-record"]
    command = [sys.executable, "-m", "meanflock.groundstation.cli"]
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    failed = subprocess.run(
        [*command, "run", "--out", str(disk.path), *flags, *settings],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        preexec_fn=disk.limit,
        check=False,
    )
    (folder,) = disk.path.iterdir()
    assert failed.returncode == 1
    assert "Traceback" not in failed.stderr
    verdict = failed.stderr.splitlines()[-1]
    assert verdict.startswith(f"error: {folder}: ")
    assert any(words in verdict for words in WORDS)
    assert f"meanflock resume {folder}" in verdict
    rows = whole(folder)
    assert f"up to tick {rows - 1}:" in verdict
    assert 20 < rows < 800
    disk.make_room()
    done = subprocess.run(
        [*command, "resume", str(folder), *flags], capture_output=True, text=True, timeout=DEADLINE_S, check=False
    )
    assert done.returncode == 0, done.stderr
    expected = Lab(scenarios.load(None, SETTINGS)).fly()
    assert json.loads((folder / "summary.json").read_text())["trajectory_sha256"] == expected["trajectory_sha256"]
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(801))
    if recorded:
        assert verify(folder / "recording.rrd") is None


@pytest.mark.processes
@pytest.mark.parametrize("disk", ["full"], indirect=True)
@pytest.mark.parametrize("room", [20, 60, 240])  # KiB: the recording cannot be begun, or its plots not be written
@pytest.mark.parametrize(
    "command", [("run", "--in-process"), ("compare", "mfg", "--seeds", "1", "--jobs", "1", "--record")]
)
def test_a_disk_that_is_full_from_the_beginning_is_a_verdict(command: tuple[str, ...], room: int, disk: Disk) -> None:
    (disk.path / "filler").write_bytes(bytes(FULL_BYTES - room * 1024))
    flags = ["--quiet", "--uavs", "2", "--duration", "40", "--out", str(disk.path)]
    line = [sys.executable, "-m", "meanflock.groundstation.cli", *command, *flags]
    done = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 1, done.stderr
    (verdict,) = done.stderr.splitlines()
    assert verdict.startswith("error: ")


@pytest.mark.processes
def test_a_ground_station_whose_disk_is_full_ends_and_the_flight_goes_on(disk: Disk, processes: Processes) -> None:
    if disk.limit is not None:
        pytest.skip("the limit would be on every process here")
    world = processes.world("--stations", "1", settings=(*SETTINGS, "duration=100000"))
    station = processes.station(disk.path)
    for _ in range(4):
        processes.start("agent")
    processes.start("leader")
    _, said = station.communicate(timeout=DEADLINE_S)
    assert station.returncode == 1
    assert "Traceback" not in said
    assert "No space left on device" in said.splitlines()[-1]
    (folder,) = disk.path.iterdir()
    assert whole(folder) > 0
    assert world.poll() is None
    disk.make_room()
    before = spool_bytes(disk.path)
    successor = processes.station(disk.path, "--resume", "latest")
    until(lambda: spool_bytes(disk.path) > before + 20_000, "telemetry")
    world.send_signal(signal.SIGINT)
    summary = json.loads(world.communicate(timeout=DEADLINE_S)[0])
    _, said = successor.communicate(timeout=DEADLINE_S)
    assert successor.returncode == 0, said
    assert (summary["lost"], summary["telemetry_blocks_dropped"]) == (0, 0)
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(summary["ticks"] + 1))


@pytest.mark.parametrize("what", ["events", "head", "rows", "checkpoint"])
def test_of_a_block_that_does_not_fit_nothing_is_kept(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.groundstation.launch.engine._BLOCK_ROWS", 20)
    lab = Lab(scenario())
    lab.fly()
    folder = RunFolder(tmp_path, "run", scenario())
    for block in lab.record.blocks[:3]:
        folder.write(block)
    folder._background.wait()
    rows = whole(tmp_path / "run")
    fits = iter({"events": (), "head": (1,), "rows": (1, 1), "checkpoint": ()}[what])
    write = durable.write

    def half(first: FileIO, content: bytes) -> None:
        if next(fits, False):
            write(first, content)
            return
        if what != "checkpoint":
            first.write(content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(durable, "replace" if what == "checkpoint" else "write", half)
    failing = next(b for b in lab.record.blocks[3:] if (b.checkpoint if what == "checkpoint" else b.events))
    if what == "checkpoint":  # beside the flight: its block has been kept, and the next one tells
        for block in lab.record.blocks[3 : lab.record.blocks.index(failing) + 1]:
            folder.write(block)
        rows = whole(tmp_path / "run")
        until(lambda: folder._background._doing is not None and folder._background._doing.done(), "the checkpoint")
    for _ in range(2):
        with pytest.raises(RunFailed, match="meanflock resume"):
            folder.write(failing)
    assert whole(tmp_path / "run") == rows
    with folder:  # completes nothing: the rows stay where a resumed run finds them
        pass
    assert whole(tmp_path / "run") == rows


def test_the_verdict_says_how_to_go_on_with_what_the_folder_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab, folder = Lab(scenario()), RunFolder(tmp_path, "run", scenario())
    lab.fly()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    again = f"meanflock run {folder.path / 'scenario.toml'}"
    for blocks, holds in (([], "nothing of the flight yet"), (lab.record.blocks[:1], "the flight up to tick 1")):
        for block in blocks:
            folder.write(structs.replace(block, checkpoint=b""))
        with monkeypatch.context() as disk:
            disk.setattr(durable, "write", full)
            with pytest.raises(RunFailed) as caught:
                folder.write(lab.record.blocks[len(blocks)])
        assert str(caught.value) == (
            f"{folder.path}: No space left on device; it holds {holds}: make room, then `{again}`"
        )
        folder._full = False
    with folder:
        pass


def test_a_disk_that_is_full_beforehand_is_bad_input_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("meanflock.groundstation.results.run_folder.Spool", full)
    with pytest.raises(BadInput, match="No space left"):
        RunFolder(tmp_path, "run", scenario())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("arguments", [("scenario", "show"), ("plugins",), ("scenario", "schema")])
def test_an_output_that_takes_no_more_is_an_error_in_a_line(arguments: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "meanflock.groundstation.cli", *arguments]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=DEADLINE_S, check=False)
    assert done.stderr == "error: standard output: No space left on device; what was flown or written is kept\n"
    assert done.returncode == 1


def test_a_run_that_has_no_room_to_go_on_asks_for_room_and_not_for_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = dead(tmp_path, scenario(LATER, method="mfg"), 150)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("meanflock.groundstation.results.run_folder.Spool", full)
    assert main(["resume", str(folder), "--in-process", "--quiet"]) == 2
    assert capsys.readouterr().err.startswith(f"error: {folder}: No space left on device; make room")


def test_an_output_that_is_closed_is_no_error() -> None:
    command = [sys.executable, "-m", "meanflock.groundstation.cli", "scenario", "show"]
    line = ["sh", "-c", '"$@" >&-', "sh", *command]
    done = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_world_whose_output_is_closed_waits_and_ends_as_any_other() -> None:
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "meanflock.worldsim", "--endpoint", endpoint, "--run", "mute", "--wait", "0.1"]
    line = ["sh", "-c", '"$@" >&-', "sh", *command]
    done = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "error: after 0 s the swarm still waits for " in done.stderr
