"""After any crash a file is the old or the new one, and no checkpoint is ahead of its rows."""

import os
import sys
import threading
from pathlib import Path

import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.resume import back
from meanflock.groundstation.results.run_folder import (
    CHECKPOINT,
    EVENTS,
    SCENARIO,
    SUMMARY,
    BackgroundWorker,
)
from meanflock.swarm import scenario as scenarios
from tests.commands import printed
from tests.faults.dying import flight

SETTINGS = ("uavs=3", "seed=7", "duration=30", "stop=duration", "federation.period=40")


def test_rows_and_events_are_on_the_disk_before_the_checkpoint_and_that_before_its_name(tmp_path, monkeypatch) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, os.replace

    def synced(handle: int) -> None:
        inode = os.fstat(handle).st_ino
        folder = tmp_path / "run"
        done.append(next((p.name for p in (folder, *folder.iterdir()) if p.stat().st_ino == inode), "elsewhere"))
        fsync(handle)

    def renamed(part: Path, path: Path) -> None:
        done.append(f"→ {Path(path).name}")
        replace(part, path)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    monkeypatch.setattr("meanflock.groundstation.launch.engine._CHECKPOINT_TICKS_AT_MOST", 100)  # as in processes
    flight(tmp_path, scenarios.load(None, SETTINGS))

    def durably(name: str) -> list[str]:
        return [f".{name}.part", f"→ {name}", "run"]

    rows = [EVENTS, ".telemetry"]
    table = "timeseries.parquet"
    assert done == [
        *(*durably(SCENARIO), "elsewhere", "→ .telemetry", "run"),
        *(3 * [*rows, *durably(CHECKPOINT)]),
        *(*rows, *durably(SUMMARY), "run"),  # and the checkpoint taken away
        *(f".{table}", f"→ {table}", "run", "run"),  # and what was spooled
    ]


KILLED = """
import os, signal, sys
from meanflock.groundstation.launch import engine
from meanflock.groundstation.cli.command import main

engine._CHECKPOINT_TICKS_AT_MOST = 100  # as in a swarm of processes

def kill_at(last):
    calls = 0
    def counted(call):
        def one(*arguments):
            nonlocal calls
            calls += 1
            if calls == last:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments)
        return one
    os.fsync, os.replace = counted(os.fsync), counted(os.replace)

for number, out in enumerate(sys.argv[1].split(":")):
    if (child := os.fork()) == 0:
        kill_at(int(sys.argv[2]) + number)
        settings = [word for setting in sys.argv[3:] for word in ("--set", setting)]
        main(["run", "--in-process", "--no-record", "--quiet", "--json", "--out", out, *settings])
        os._exit(3)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
"""


@pytest.mark.processes
def test_a_run_killed_at_any_step_of_replacing_its_checkpoint_resumes_to_the_same_end(tmp_path: Path) -> None:
    expected = Engine(scenarios.load(None, SETTINGS), "whole").complete()["trajectory_sha256"]
    # Six calls make the folder and five the first checkpoint: these are all of the second's, and the next.
    outs = [tmp_path / str(number) for number in range(6)]
    printed(sys.executable, "-c", KILLED, ":".join(map(str, outs)), "12", *SETTINGS)
    starts = []
    for out in outs:
        (folder,) = out.iterdir()
        starts.append(back(folder).start.tick)
        assert main(["resume", str(folder), "--in-process", "--no-record", "--quiet", "--json"]) == 0
        assert f'"trajectory_sha256": "{expected}"' in (folder / SUMMARY).read_text()
        assert sorted(path.name for path in folder.iterdir()) == [EVENTS, SCENARIO, SUMMARY, "timeseries.parquet"]
    assert starts == [1, 1, 1, 1, 101, 101]


@pytest.mark.parametrize("call", ["do", "wait", "close", "look"])
def test_the_next_call_raises_the_error_of_the_work_once(call: str) -> None:
    aside, go = BackgroundWorker("test"), threading.Event()

    def fail() -> None:
        go.wait()
        raise OSError(28, "No space left on device")

    aside.do(fail)
    aside.look()  # does not wait
    go.set()
    assert aside._doing is not None
    aside._doing.exception(10.0)
    with pytest.raises(OSError, match="No space"):
        getattr(aside, call)(*[lambda: None] * (call == "do"))
    aside.look()
    aside.close()
