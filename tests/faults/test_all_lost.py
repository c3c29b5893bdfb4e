"""A flight that loses every agent stands still until one is back, and fails, to be resumed from before, if none is."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from meanflock.cli.command import main
from meanflock.launch.resume import back
from meanflock.results.run_folder import RunFolder
from meanflock.swarm.errors import RunFailed
from tests.controller_files import controller_file
from tests.faults.conftest import Lab, honest, scenario


class Patient(Lab):
    """A lab whose world waits on a clock that goes on by half a second each time it waits."""

    def __init__(self, *settings: str, **options: Any) -> None:
        super().__init__(scenario(*settings), **options)
        self.waited_s = 0.0
        self.waits = 0
        self.while_waiting: dict[int, Callable[[], Any]] = {}
        self.now = lambda: self.waited_s
        self.engine.hub.receive = self._wait

    def _wait(self, timeout_s: float) -> None:
        self.waited_s += 0.5
        if not self.world.over:
            self.waits += 1
            self.while_waiting.get(self.waits, lambda: None)()

    def kill_all(self) -> None:
        for member in list(self.engine.nodes.members.present):
            if member.role == "agent":
                self.kill(member.name)


def test_a_flight_without_agents_stands_still_until_the_first_is_back() -> None:
    lab = Patient("uavs=3", uavs_per_node=1)
    lab.while_waiting = {5: lab.agent}
    summary = lab.fly({40: lab.kill_all})
    assert lab.waits == 5
    assert lab.record.kinds("lost", "rejoined") == [(40, "lost")] * 3 + [(40, "rejoined")]
    assert (summary["ticks"], summary["lost"]) == (120, 2)
    assert (summary["nodes_lost"], summary["nodes_rejoined"]) == (3, 1)


@pytest.mark.parametrize("stop", ["duration", "arrival"])
def test_a_flight_without_agents_fails_after_the_time_of_a_barrier_if_no_agent_comes_back(stop: str) -> None:
    lab = Patient(f"stop={stop}")
    with pytest.raises(RunFailed, match="every agent is lost, and none came back within 10 s"):
        lab.fly({40: lab.kill_all})
    assert 10.0 < lab.waited_s <= 11.0
    assert lab.record.kinds("failed", "finished") == [(40, "failed")]
    assert lab.world.flight.tick == 40


@pytest.mark.parametrize("together", [True, False])
def test_the_last_checkpoint_of_a_run_that_falls_apart_is_of_before(together: bool, tmp_path: Path) -> None:
    """All agents at once, or one after the other on both sides of the tick of a checkpoint."""
    lab = Patient("duration=35", uavs_per_node=1)
    falls = {195 + 2 * uav: lambda uav=uav: lab.kill(f"agent-{uav}") for uav in range(6)}
    folder = RunFolder(tmp_path, "run", scenario("duration=35"))
    lab.engine.station._sinks = [folder]
    with pytest.raises(RunFailed), folder:
        lab.fly({198: lab.kill_all} if together else falls)
    kept = back(tmp_path / "run")
    assert kept.start.tick == 101
    summary = Lab(kept.scenario, resume=kept.start).fly()
    assert summary["trajectory_sha256"] == honest(scenario("duration=35"))
    assert (summary["lost"], summary["nodes_lost"]) == (0, 0)


def test_a_loss_for_good_delays_checkpoints_no_longer_than_a_barrier(tmp_path: Path) -> None:
    lab = Patient("duration=45", uavs_per_node=1)

    def later() -> None:
        lab.waited_s += 11.0

    lab.fly({150: lambda: lab.kill("agent-4"), 250: later})
    kept = [block.first_tick + len(block.states) for block in lab.record.blocks if block.checkpoint]
    assert kept == [2, 102, 302, 402]


@pytest.mark.parametrize(
    ("method", "killed", "code"),
    [("breaks", [], 1), ("breaks", [0, 2], 1), ("breaks", [0, 1, 2], 0), ("plan", [0, 1, 2], 0)],
)
def test_a_run_has_failed_if_it_lost_every_uav_and_no_script_killed_them(
    method: str, killed: list[int], code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugin = controller_file(tmp_path, "breaks", "return mf.Step(memory, -own[:, :2] * (1 / (10 - tick)))")
    kills = f', {{kind="kill", tick=5, uavs={killed}}}' if killed else ""
    script = f'faults=[{{kind="leader-loss", tick=2}}{kills}]'  # the loss of a leader is not that of a UAV
    flags = ["--plugin", str(plugin), "--method", method, "--uavs", "3", "--duration", "2"]
    flags += ["--set", script, "--no-record", "--json", "--quiet", "--out", str(tmp_path / "out")]
    assert main(["run", "--in-process", *flags]) == code
    printed, told = capsys.readouterr()
    (folder,) = (tmp_path / "out").iterdir()
    summary = json.loads(printed)
    assert summary == json.loads((folder / "summary.json").read_text())
    assert summary["lost"] == (3 if method == "breaks" else len(killed))
    errors = [line for line in told.splitlines() if line.startswith("error: every UAV was lost: ")]
    assert len(errors) == code
    assert all(str(folder) in error for error in errors)
    assert killed or "ZeroDivisionError: division by zero (breaks.py, line 8)" in errors[0]
