"""The runner of all studies: signals while its processes start and end, and processes that die."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from meanflock.studies import runner, study
from meanflock.studies.paper.experiments import run_grid
from meanflock.studies.paper.grid import Point, Wanted
from meanflock.studies.store import Store
from meanflock.swarm import plugins
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.scenario import Scenario, load
from tests.polling import DEADLINE_S
from tests.studies.studies import interrupted

_START = """
import signal, sys
from pathlib import Path
from meanflock.studies.runner import _signals_deferred, terminable
from meanflock.swarm.errors import RunFailed
number = int(sys.argv[1])
signal.signal(signal.SIGINT, signal.default_int_handler)
before = signal.getsignal(number)
try:
    with terminable(Path("there")), _signals_deferred():
        signal.raise_signal(number)
        signal.raise_signal(number)
        print("finished")
except RunFailed as error:
    print(error, signal.getsignal(number) == before)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_are_deferred_to_the_end_of_a_block(number: signal.Signals) -> None:
    """In a process of its own: signals to that of the tests would end more than this one."""
    command = [sys.executable, "-c", _START, str(int(number))]
    printed = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=True).stdout
    assert printed.splitlines() == [
        "finished",
        "interrupted; flights that were finished are kept in there/data: repeat the command to go on True",
    ]


_ENDED = """
import time
from functools import partial
from meanflock.studies import runner

def stop(task, result):
    raise KeyboardInterrupt

for _ in range(5):  # without `if __name__ == "__main__"`: workers do not import the script
    try:
        runner.run(time.sleep, [0.0, *[10.0] * 8], 2, stop)
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.mark.processes
def test_a_pool_that_is_ended_in_the_middle_is_silent(tmp_path: Path) -> None:
    """Neither a traceback of its threads, nor a warning of semaphores that leaked."""
    script = tmp_path / "script.py"
    script.write_text(_ENDED)
    command = [sys.executable, str(script)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "interrupted\n" * 5, "")


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


@pytest.fixture
def dying(request: pytest.FixtureRequest, tmp_path: Path) -> list[Scenario]:
    """Four flights; the second kills each process that flies it, or only the first such process."""
    file = tmp_path / "dying.py"
    file.write_text(DYING.format(parent=os.getpid(), mark=request.param))
    plugins.load_files([file])
    return study.seeded(load(None, method="dying", uavs=2, duration=1.0), 4)


ONCE, ALWAYS = "marker.touch()", "pass"


@pytest.mark.processes
@pytest.mark.parametrize("dying", [ONCE], indirect=True)
def test_a_flight_whose_process_died_is_tried_again(dying: list[Scenario], tmp_path: Path) -> None:
    def hashes(jobs: int) -> list[str]:
        flown = study.fly_all({"dying": dying}, jobs, lambda *_: None, Store(tmp_path / str(jobs)))
        return [summary["trajectory_sha256"] for summary in flown["dying"]]

    assert hashes(2) == hashes(1)
    assert (tmp_path / "dying.died").exists()


@pytest.mark.processes
@pytest.mark.parametrize("dying", [ALWAYS], indirect=True)
def test_a_flight_whose_process_died_twice_ends_the_study_which_can_go_on(
    dying: list[Scenario], tmp_path: Path
) -> None:
    out = tmp_path / "study"
    with pytest.raises(RunFailed, match=rf"died twice.* of 4 runs are kept in {out}"):
        study.fly_all({"dying": dying}, 2, lambda *_: None, Store(out))
    flown = study.fly_all({"dying": dying}, 1, lambda *_: None, Store(out))
    assert len(flown["dying"]) == 4


def test_a_grid_names_the_experiments_that_a_process_may_have_died_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = [Wanted(Point("s0", load(None, method="hjb")), 1)]

    def dies(*_: object) -> None:
        raise runner.WorkerDied(plan)

    monkeypatch.setattr(runner, "run", dies)
    with pytest.raises(RunFailed, match=r"died twice on one of: s0 hjb; the rest is kept"):
        run_grid(tmp_path, 1, quiet=True, plan=plan)


@pytest.mark.processes
def test_ctrl_c_ends_the_grid_and_its_workers(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from meanflock.studies.paper.experiments import run_grid\n"
        f"run_grid(Path({str(tmp_path)!r}), 1, {{'s0'}}, jobs=2)"
    )
    exit_code, _, said = interrupted([sys.executable, "-c", code], tmp_path)
    assert exit_code == 1
    assert b"RunFailed: interrupted" in said


def test_negative_numbers_of_jobs_count_down_from_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(4), raising=False)
    assert [runner._number_of(jobs) for jobs in (-9, -4, -2, -1, 1, 7)] == [1, 1, 3, 4, 1, 7]


@pytest.mark.parametrize(
    ("limit", "cores"), [("150000 100000", 2), ("50000 100000", 1), ("max 100000", None), ("", None)]
)
def test_a_container_s_share_of_the_cores_bounds_the_processes(limit: str, cores: int | None, tmp_path: Path) -> None:
    (tmp_path / "cpu.max").write_text(limit)
    bound = runner.cores(tmp_path / "nowhere")
    assert runner.cores(tmp_path) == (bound if cores is None else min(cores, bound))
