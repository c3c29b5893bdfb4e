"""Runs that die in the middle, and go on."""

import json
from pathlib import Path
from typing import Any

import pytest

from meanflock.cli.command import main
from meanflock.launch.engine import Engine
from meanflock.launch.resume import Back
from meanflock.results.quantities import VARYING
from meanflock.results.run_folder import RunFolder
from meanflock.swarm.scenario import Scenario

LATER = "duration=35"  # checkpoints in ticks 1, 101, 201 and 301


class Died(Exception):
    """What ends a flight in the middle of these tests."""


def flight(
    out: Path, flown: Scenario, dies_at: int | None = None, rows: int | None = None, kept: Back | None = None
) -> dict[str, Any]:
    """A run into a folder, or on from what is `kept` in it; where it dies, only what is on the disk is left."""
    past, start = (kept.past, kept.start) if kept is not None else (None, None)
    folder = RunFolder(out, "run", flown, past)
    engine = Engine(flown, "run", sinks=[folder], uavs_per_node=rows, resume=start)
    for tick in engine.fly():
        if tick == dies_at:
            folder._background.wait()  # a checkpoint is written beside the flight
            folder._spool = None  # as after kill -9: nothing is completed
            folder._events.close()
            raise Died
    summary = engine.finish()
    with folder:
        folder.summarise(summary)
    return json.loads((folder.path / "summary.json").read_text())


def dead(out: Path, flown: Scenario, at: int, rows: int | None = None, kept: Back | None = None) -> Path:
    with pytest.raises(Died):
        flight(out, flown, at, rows, kept)
    return out / "run"


def resumed(folder: Path, *flags: str, in_process: bool = True, record: bool = False) -> dict[str, Any]:
    mode = (*(("--in-process",) if in_process else ()), *(() if record else ("--no-record",)))
    assert main(["resume", str(folder), *mode, "--quiet", "--json", *flags]) == 0
    return json.loads((folder / "summary.json").read_text())


def steady(summary: dict[str, Any], *but: str) -> dict[str, Any]:
    return {k: v for k, v in summary.items() if k not in VARYING | set(but)}


def events(folder: Path, *without: str) -> list[Any]:
    told = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    return [event for event in told if event["kind"] not in without]
