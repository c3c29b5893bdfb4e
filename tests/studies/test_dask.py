"""The grid on a cluster: dask workers instead of processes of our own, and nothing else changes."""

import json
from pathlib import Path

import pytest

from meanflock.studies.paper.experiments import run_grid
from meanflock.studies.paper.grid import Point, Wanted
from meanflock.studies.paper.report.write import write_report
from meanflock.studies.paper.verdict import evaluate
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load

distributed = pytest.importorskip("distributed", reason="dask is not installed")
pytestmark = [pytest.mark.processes, pytest.mark.usefixtures("environment")]


def plan() -> list[Wanted]:
    points = [
        Point("s0", load(None, ["federation.period=10"], method=method, uavs=4, duration=6.0, stop="duration"))
        for method in ("hjb", "mfgfl-h", "mfgfl-f", "mfgfl-hf")
    ]
    return [Wanted(point, seed) for point in points for seed in (1, 2, 3)]


def test_a_local_cluster_finds_the_same_claims_to_the_last_digit(tmp_path: Path) -> None:
    here = run_grid(tmp_path / "processes", 1, jobs=1, quiet=True, plan=plan())
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        there = run_grid(
            tmp_path / "dask", 1, backend="dask", scheduler=cluster.scheduler_address, quiet=True, plan=plan()
        )
    for results, name in ((here, "processes"), (there, "dask")):
        write_report(results, evaluate(results), tmp_path / name)
    claims = [(tmp_path / name / "claims.json").read_text() for name in ("processes", "dask")]
    assert claims[0] == claims[1]
    assert sum(record["verdict"] != "not testable" for record in json.loads(claims[0])) > 5


def test_without_a_scheduler_it_makes_a_cluster_of_its_own_on_this_machine(tmp_path: Path) -> None:
    here = run_grid(tmp_path / "processes", 1, jobs=1, quiet=True, plan=plan()[:2])
    there = run_grid(tmp_path / "dask", 1, jobs=1, backend="dask", quiet=True, plan=plan()[:2])
    assert there.runs["trajectory_sha256"].to_pylist() == here.runs["trajectory_sha256"].to_pylist()


def test_a_scheduler_of_another_backend_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="is of dask"):
        run_grid(tmp_path, 1, scheduler="tcp://127.0.0.1:9", quiet=True, plan=plan())


def test_a_scheduler_that_is_not_there_is_bad_input_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.studies.runner.SCHEDULER_TIMEOUT", "1s")  # nobody will come
    with pytest.raises(BadInput, match=r"127\.0\.0\.1:9"):
        run_grid(tmp_path, 1, backend="dask", scheduler="tcp://127.0.0.1:9", quiet=True, plan=plan())
