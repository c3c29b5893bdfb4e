"""Golden matrix: every flight of the table has its trajectory and its bill in every mode.

Modes: one node; nodes of one UAV and of several; NumPy's kernels in a process of their own; killed in the middle and
resumed in another division. Flights of real processes: tests/integration/test_processes.py.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.launch.resume import back
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.faults.dying import dead, events, flight, resumed
from tests.golden.flights import Golden, machine, read, steady

FLOWN_ON, FLIGHTS = read()
SHORT = [row for row in FLIGHTS if row.name.startswith("short-")]
RESUMED = [row for row in SHORT if row.scenario.max_ticks > 150]  # long enough for a checkpoint to resume from
NUMPY = """
import json, sys
from tests.golden.flights import read
for row in read()[1]:
    if row.name.startswith("short-"):
        print(json.dumps(row.fly()))
"""
every = pytest.mark.parametrize("row", FLIGHTS, ids=lambda row: row.name)
short = pytest.mark.parametrize("row", SHORT, ids=lambda row: row.name)


@pytest.fixture(scope="module")
def whole() -> dict[str, dict[str, Any]]:
    """Summaries of the flights in one node, by name; each is flown when it is first asked for."""

    class Flown(dict[str, dict[str, Any]]):
        def __missing__(self, name: str) -> dict[str, Any]:
            self[name] = next(row for row in FLIGHTS if row.name == name).fly()
            return self[name]

    return Flown()


@every
def test_a_flight_in_one_node_is_the_golden_one(row: Golden, whole: dict[str, Any]) -> None:
    assert whole[row.name]["dropped_messages"] == {}
    if machine() != FLOWN_ON:
        pytest.skip("the last bits of NumPy's functions differ on this processor; the modes are compared all the same")
    row.check(whole[row.name])


@short
@pytest.mark.parametrize("rows", [1, 4])
def test_a_flight_in_several_nodes_is_that_of_one(row: Golden, rows: int, whole: dict[str, Any]) -> None:
    cut = row.fly(uavs_per_node=rows)
    assert cut["dropped_messages"] == {}
    assert steady(cut) == steady(whole[row.name])


def test_flights_with_the_kernels_of_numpy_are_those_of_the_compiled_ones(whole: dict[str, Any]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", NUMPY],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "MEANFLOCK_PURE": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    for row, line in zip(SHORT, done.stdout.splitlines(), strict=True):
        summary = json.loads(line)
        assert summary["backend"] == "numpy"
        expected = json.loads(json.dumps(steady(whole[row.name])))
        assert steady(summary) == expected, row.name


@pytest.mark.parametrize("row", RESUMED, ids=lambda row: row.name)
def test_a_flight_that_was_killed_and_resumed_leaves_the_files_of_the_undisturbed_one(
    row: Golden, whole: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.groundstation.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
    flight(tmp_path / "whole", row.scenario)
    folder = dead(tmp_path / "dead", row.scenario, min(287, row.scenario.max_ticks - 20), rows=2)
    assert back(folder).start.tick >= 101
    summary = resumed(folder, "--uavs-per-process", "4")
    assert steady(summary) == json.loads(json.dumps(steady(whole[row.name])))
    tables = [pq.read_table(out / "timeseries.parquet") for out in (folder, tmp_path / "whole" / "run")]
    assert tables[0]["tick"].to_pylist() == list(range(len(tables[1])))
    assert tables[0].equals(tables[1])
    joins = ("joined", "resumed", "leader", "rejoined")
    assert events(folder, *joins) == events(tmp_path / "whole" / "run", *joins)
    assert sorted(path.name for path in folder.iterdir()) == [
        "events.jsonl",
        "scenario.toml",
        "summary.json",
        "timeseries.parquet",
    ]
