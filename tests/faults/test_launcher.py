"""The launcher of `meanflock run`: the agents that it starts again itself, and a world that it cannot hear."""

import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from meanflock.groundstation.launch.children import Child
from meanflock.groundstation.launch.processes import Swarm
from meanflock.groundstation.launch.run import _listen
from meanflock.groundstation.launch.station import Station
from meanflock.groundstation.results.run_folder import RunFolder
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.net.bus import MemoryNetwork
from meanflock.swarm.process import Interrupted
from tests.polling import until

SHORT = 'duration = 100000\nstop = "duration"\nmethod = "mfg"'


@pytest.mark.processes
def test_the_launcher_starts_a_killed_agent_again_where_nothing_is_forked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("meanflock.agent.prefork.SAFE", False)
    with Swarm("alone") as swarm:
        swarm.start_world(f"uavs = 2\n{SHORT}", wait_s=60.0, realtime=None)
        swarm.start_agents(2, 1, 60.0)
        victim = swarm._children[2]
        first = victim.process
        first.kill()
        first.wait()
        until(lambda: swarm.check(flying=True) or victim.process is not first, "another one")
        while victim.process.poll() is None or not victim.given_up:
            victim.process.kill()
            victim.process.wait()
            swarm.check(flying=True)
        assert [child.given_up for child in swarm._children] == [False, False, True]


@pytest.mark.skipif(sys.platform != "linux", reason="agents are forked on Linux only")
@pytest.mark.processes
def test_the_launcher_starts_the_process_that_forks_agents_again_if_it_dies_before_it_forks() -> None:
    with Swarm("unborn") as swarm:
        swarm.start_world(f"uavs = 2\n{SHORT}", wait_s=60.0, realtime=None)
        swarm.start_agents(2, 1, 60.0)
        child = swarm._children[1]
        for flying in (False, True):
            process = child.process
            process.kill()  # while it loads what its agents need
            process.wait()
            swarm.check(flying)
            assert (child.process is process, child.given_up) == (flying, flying)
            if not flying:
                until(lambda: len(psutil.Process(child.process.pid).children()) == 2, "two agents")


def test_a_world_that_ended_unheard_is_noticed_and_the_run_can_be_resumed(tmp_path: Path) -> None:
    """As after a long freeze of this process: the world has waited for it, and left."""
    flown = scenarios.load(None, ["uavs=2", "duration=30", "method=mfg"])
    bus = MemoryNetwork().endpoint()
    with RunFolder(tmp_path, "run", flown) as folder, Swarm("run") as swarm, Interrupted() as interrupted:
        left = subprocess.Popen([sys.executable, "-c", ""])
        child = Child("world", "worldsim", [], tmp_path / "log")
        child.process = left
        swarm._children.append(child)
        (tmp_path / "log").touch()
        with pytest.raises(
            RunFailed, match=r"the world ended .*, before take-off; `meanflock run .*run/scenario\.toml`"
        ):
            _listen(bus, Station(bus, "run", [folder]), swarm, interrupted, folder)
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(RunFailed, match=r"^interrupted, before take-off; `meanflock run .*run/scenario\.toml`"):
            _listen(bus, Station(bus, "run", [folder]), swarm, interrupted, folder)
