"""Golden matrix: every flight of the table has its trajectory and its bill in every mode.

Modes: one node, recorded; NumPy's kernels in a process of their own; nodes of one UAV, killed in the middle and resumed
in nodes of four; nodes of one UAV to the end, where a flight is too short for that. Flights of real processes:
tests/integration/test_processes.py.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from meanflock.launch.resume import back
from meanflock.results.rounds_table import ROUNDS
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.commands import printed
from tests.faults.dying import dead, events, flight, resumed
from tests.golden.flights import Golden, processor, read, steady

FLIGHTS = read()
SHORT = [row for row in FLIGHTS if row.name.startswith("short-")]
RESUMED = [row for row in SHORT if row.scenario.max_ticks > 150]  # long enough for a checkpoint to resume from
UNBROKEN = [row for row in SHORT if row not in RESUMED]
# Flights that use all kernels, each in all of its cases.
NUMPY = {
    *("short-hjb", "short-mfgfl-hf", "short-offline", "short-multinomial", "short-separation", "short-encounters"),
    *("short-orca", "short-bvc", "short-braking", "short-crowd-mfgfl-h", "short-windmap", "short-events"),
    *("short-int8", "short-clusters-hf", "short-doubles", "short-quiet", "short-waves", "short-discs"),
    *("short-space-cruise", "short-space-orca", "short-space-braking", "short-space-hf", "short-space-mast"),
    *("short-space-quadrotor", "short-space-multirotor", "short-groups", "short-space-groups", "short-patrol"),
}
FLY = """
import json, sys
from tests.golden.flights import read
for row in read():
    if row.name in sys.argv:
        print(json.dumps(row.fly()))
"""
every = pytest.mark.parametrize("row", FLIGHTS, ids=lambda row: row.name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Golden], Path]]:
    """The run folder of a flight in one node, which is flown when it is first asked for."""
    out = tmp_path_factory.mktemp("whole")

    def folder_of(row: Golden) -> Path:
        if not (out / row.name).exists():
            flight(out / row.name, row.scenario)
        return out / row.name / "run"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("meanflock.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
        yield folder_of


def summary_in(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())


def same(summary: dict[str, Any], folder: Path) -> None:
    """Compares a flight with the recorded one."""
    assert summary["dropped_messages"] == {}
    assert json.loads(json.dumps(steady(summary))) == steady(summary_in(folder))


@every
def test_a_flight_in_one_node_is_the_golden_one(row: Golden, whole: Callable[[Golden], Path]) -> None:
    summary = summary_in(whole(row))
    assert summary["dropped_messages"] == {}
    if processor() not in row.sha256:
        pytest.skip("no such processor has flown the table; the last bits of NumPy's functions may differ on it")
    row.check(summary)


@pytest.mark.parametrize("row", UNBROKEN, ids=lambda row: row.name)
def test_a_flight_in_nodes_of_one_uav_is_that_of_one_node(row: Golden, whole: Callable[[Golden], Path]) -> None:
    same(row.fly(uavs_per_node=1), whole(row))


def test_flights_with_the_kernels_of_numpy_are_those_of_the_compiled_ones(whole: Callable[[Golden], Path]) -> None:
    rows = [row for row in SHORT if row.name in NUMPY]
    assert len(rows) == len(NUMPY)
    pure = os.environ | {"MEANFLOCK_PURE": "1"}
    flown = printed(sys.executable, "-c", FLY, *NUMPY, cwd=Path(__file__).parents[2], env=pure, timeout=300)
    for row, line in zip(rows, flown.splitlines(), strict=True):
        summary = json.loads(line)
        assert summary["backend"] == "numpy"
        same(summary, whole(row))


@pytest.mark.parametrize("row", RESUMED, ids=lambda row: row.name)
def test_a_flight_that_was_killed_and_resumed_leaves_the_files_of_the_undisturbed_one(
    row: Golden, whole: Callable[[Golden], Path], tmp_path: Path
) -> None:
    undisturbed = whole(row)
    folder = dead(tmp_path, row.scenario, 287 if row.scenario.faults else 130, rows=1)
    assert back(folder).start.tick >= 101
    same(resumed(folder, "--uavs-per-process", "4"), undisturbed)
    tables = [pq.read_table(out / "timeseries.parquet") for out in (folder, undisturbed)]
    assert tables[0]["tick"].to_pylist() == list(range(len(tables[1])))
    assert tables[0].equals(tables[1])
    joins = ("joined", "resumed", "leader", "rejoined")
    assert events(folder, *joins) == events(undisturbed, *joins)
    files = {"events.jsonl", "scenario.toml", "summary.json", "timeseries.parquet"}
    if row.scenario.vehicle.file is not None:
        files.add("vehicle")
    if (undisturbed / ROUNDS).exists():
        files.add(ROUNDS)
        rounds = [pq.read_table(out / ROUNDS) for out in (folder, undisturbed)]
        assert rounds[0].equals(rounds[1])
    assert {path.name for path in folder.iterdir()} == files
