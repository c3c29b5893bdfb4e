"""The runner of all studies: signals, dead processes, number of processes."""

import os
import signal
from pathlib import Path

import pytest

from meanflock.studies import runner, study
from meanflock.studies.store import Store
from meanflock.swarm import plugins
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.scenario import load

DYING = """
import os, signal
from pathlib import Path
import meanflock as mf

class Dying(mf.Controller):
    name = "dying"

    def step(self, memory, tick, own, received):
        marker = Path(__file__).with_suffix(".died")
        if os.getpid() != {parent} and self.scenario.seed == 2 and not marker.exists():
            {mark}
            os.kill(os.getpid(), signal.SIGKILL)
        return mf.Step(memory, 0.0 * own[:, :2])
"""


@pytest.mark.processes
def test_a_flight_whose_process_dies_is_tried_twice(tmp_path: Path) -> None:
    """The second of four flights kills its process, once or always; a repeated study flies the rest."""

    def hashes(mark: str, jobs: int, out: Path) -> list[str]:
        file = tmp_path / "dying.py"
        file.write_text(DYING.format(parent=os.getpid(), mark=mark))
        plugins.load_files([file])
        flights = study.seeded(load(None, method="dying", uavs=2, duration=1.0), 4)
        flown = study.fly_all({"dying": flights}, jobs, lambda *_: None, Store(out))
        return [summary["trajectory_sha256"] for summary in flown["dying"]]

    alone, pool = hashes("pass", 1, tmp_path / "alone"), tmp_path / "pool"
    with pytest.raises(RunFailed, match=rf"died twice.* of 4 runs are kept in {pool}"):
        hashes("pass", 2, pool)
    assert hashes("marker.touch()", 2, pool) == alone
    assert (tmp_path / "dying.died").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_processes_start_waits_for_the_end_of_the_block(number: signal.Signals) -> None:
    done: list[object] = []
    before = signal.signal(number, lambda number, _: done.append(number))
    try:
        with runner._signals_deferred():
            signal.raise_signal(number)
            done.append("started")
    finally:
        signal.signal(number, before)
    assert done == ["started", number]


def test_negative_numbers_of_jobs_count_down_from_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(4), raising=False)
    assert [runner._number_of(jobs) for jobs in (-9, -4, -2, -1, 1, 7)] == [1, 1, 3, 4, 1, 7]


@pytest.mark.parametrize(
    ("limit", "cores"), [("150000 100000", 2), ("50000 100000", 1), ("max 100000", None), ("", None)]
)
def test_the_cores_of_a_container_bound_the_processes(limit: str, cores: int | None, tmp_path: Path) -> None:
    (tmp_path / "cpu.max").write_text(limit)
    bound = runner.cores(tmp_path / "nowhere")
    assert runner.cores(tmp_path) == (bound if cores is None else min(cores, bound))
