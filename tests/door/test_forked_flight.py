"""A fork of a process with a stepped flight: the run folder stays that of the process that began the flight."""

import sys
from pathlib import Path

import pytest

from tests.commands import printed

FORK = """
import os, sys
import numpy as np
import meanflock as mf

out, how = sys.argv[1:]
flight = mf.Stepped("paper", uavs=3, seed=1, duration=30.0, out=out)
for _ in range(150):
    flight.step(np.zeros((3, 2)))
child = os.fork()
if child == 0:
    try:
        if how == "leaves":
            with flight:
                raise ValueError
        if how == "ends":
            sys.exit()
        for _ in range(150 if how == "flies" else 10):
            flight.step(np.ones((3, 2)))
        flight.finish()
    except mf.RunFailed as error:
        os._exit(7 if "a fork of it cannot fly it on" in str(error) else 8)
    except ValueError:
        os._exit(0)
ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
assert ended == (7 if how in ("flies", "finishes") else 0), ended
while not flight.over:
    flight.step(np.zeros((3, 2)))
run = flight.finish()
stored = mf.open(run.folder)
assert stored.summary == run.summary
assert stored.frame()["tick"].to_pylist() == list(range(301))
assert np.array_equal(stored.states, run.states)
assert sorted(os.listdir(run.folder)) == ["events.jsonl", "scenario.toml", "summary.json", "timeseries.parquet"]
"""


@pytest.mark.processes
@pytest.mark.parametrize("how", ["flies", "finishes", "leaves", "ends"])
def test_a_fork_changes_nothing_in_the_folder_of_its_parent(tmp_path: Path, how: str) -> None:
    printed(sys.executable, "-c", FORK, tmp_path, how)
