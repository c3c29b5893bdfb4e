"""After any crash a file is the old or the new one, and no checkpoint is ahead of its rows."""

import os
from pathlib import Path

from meanflock.groundstation.results.run_folder import (
    CHECKPOINT,
    EVENTS,
    SCENARIO,
    SUMMARY,
)
from meanflock.swarm import scenario as scenarios
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
