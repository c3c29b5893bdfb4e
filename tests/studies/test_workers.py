"""The workers of a grid: killed, interrupted, or as many as asked for, they change nothing."""

import os
import signal
import sys
from pathlib import Path

import pytest

from meanflock.studies.paper import experiments
from meanflock.studies.paper.grid import Wanted
from meanflock.swarm.errors import RunFailed
from tests.studies.studies import interrupted
from tests.studies.tiny import fly, plan, same


def test_a_killed_worker_costs_a_second_try(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marker = str(tmp_path / "killed")

    def killed_once(number: int, run: Wanted) -> tuple[int, bytes]:

        from meanflock.studies.paper import experiments

        try:
            os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return number, experiments.execute(run)
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError

    monkeypatch.setattr(experiments, "_one", killed_once)
    killed = fly(tmp_path / "killed-once", jobs=2)
    monkeypatch.undo()
    assert same(killed, fly(tmp_path / "plain"))


def test_a_run_that_always_dies_ends_the_grid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(number: int, run: Wanted) -> tuple[int, bytes]:

        from meanflock.studies.paper import experiments

        if run.scenario.method == "hjb":
            os.kill(os.getpid(), signal.SIGKILL)
        return number, experiments.execute(run)

    monkeypatch.setattr(experiments, "_one", killed)
    with pytest.raises(RunFailed, match=r"died twice.*hjb"):
        fly(tmp_path, jobs=2)
    monkeypatch.undo()
    assert fly(tmp_path).runs.num_rows == len(plan())


@pytest.mark.processes
def test_ctrl_c_ends_the_grid_and_its_workers(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from meanflock.studies.paper.experiments import run_grid\n"
        f"run_grid(Path({str(tmp_path)!r}), 1, {{'s0'}}, jobs=2)"
    )
    exit_code, _, said = interrupted([sys.executable, "-c", code], tmp_path)
    assert exit_code == 1
    assert b"RunFailed: interrupted" in said
