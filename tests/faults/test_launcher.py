"""`meanflock run` on a bad day: what dies is started again, and what cannot go on can be resumed from before."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.children import Child
from meanflock.groundstation.launch.processes import Swarm
from meanflock.groundstation.launch.resume import back
from meanflock.groundstation.launch.run import _connect, _listen
from meanflock.groundstation.launch.station import Station
from meanflock.groundstation.results.run_folder import CHECKPOINT, RunFolder
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import BusError, RunFailed
from meanflock.swarm.net.bus import MemoryNetwork
from meanflock.swarm.net.session import LEASE
from meanflock.swarm.process import Interrupted
from tests.faults.conftest import Lab, events_in, spool_bytes
from tests.polling import DEADLINE_S, until

FLOWN = ("uavs=5", "seed=7", "duration=600", "stop=duration", "federation.period=40", "method=fed-lspi")
COMMAND = [sys.executable, "-m", "meanflock.groundstation.cli"]
ENVIRONMENT = {**os.environ, "MEANFLOCK_BARRIER": "4"}
endless = pytest.mark.parametrize("launched", [["duration=100000"]], indirect=True)
linux = pytest.mark.skipif(sys.platform != "linux", reason="agents are forked on Linux only")


def _hang_up_ends() -> None:
    """SIGHUP ends a process, also where the tests are run by `nohup`."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class Launched:
    """`meanflock run` of `FLOWN`, and its processes."""

    def __init__(self, out: Path, *more: str) -> None:
        self.out = out
        settings = [word for setting in (*FLOWN, *more) for word in ("--set", setting)]
        line = [*COMMAND, "run", "--out", str(out), "--no-record", "--quiet", "--json", *settings]
        self.process = subprocess.Popen(
            line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT, preexec_fn=_hang_up_ends
        )

    @property
    def folder(self) -> Path:
        """The only run folder."""
        (folder,) = self.out.iterdir()
        return folder

    def of(self, module: str) -> psutil.Process:
        """The process of a module that the launcher itself has started."""
        (found,) = (p for p in psutil.Process(self.process.pid).children() if f"meanflock.{module}" in p.cmdline())
        return found

    def agents(self) -> list[psutil.Process]:
        """The forked agents, the one that was started last first."""
        return sorted(self.of("agent").children(), key=lambda p: (p.create_time(), p.pid), reverse=True)

    def told(self, kind: str, count: int) -> list[dict[str, Any]]:
        """Waits for so many events of a kind."""
        return until(
            lambda: len(found := [e for e in events_in(self.folder) if e["kind"] == kind]) >= count and found,
            f"{count} events {kind}",
        )

    def ended(self, code: int) -> tuple[str, str]:
        """Waits for the command to end with that exit code; its output and errors."""
        out, err = self.process.communicate(timeout=DEADLINE_S)
        assert self.process.returncode == code, err
        return out, err

    def summary(self) -> dict[str, Any]:
        """Waits for the command to end well; what it printed."""
        return json.loads(self.ended(0)[0])

    def interrupted(self) -> dict[str, Any]:
        """Ends a flight that would not end; its summary."""
        self.process.send_signal(signal.SIGINT)
        self.ended(1)
        return json.loads((self.folder / "summary.json").read_text())


@contextmanager
def flying(out: Path, *settings: str) -> Iterator[Launched]:
    """A run that has begun to fly, and is ended with the context."""
    run = Launched(out, *settings)
    try:
        until(lambda: spool_bytes(run.out) > 20_000, "telemetry")
        yield run
    finally:
        if run.process.poll() is None:
            run.process.kill()
        run.process.communicate()


@pytest.fixture
def launched(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Launched]:
    with flying(tmp_path / "runs", *getattr(request, "param", ())) as run:
        yield run


def alive(process: psutil.Process) -> bool:
    """Whether a process still runs."""
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


@pytest.fixture(scope="module")
def undisturbed() -> str:
    """The hash of `FLOWN` when nothing happens."""
    return str(Lab(scenarios.load(None, FLOWN)).fly()["trajectory_sha256"])


@linux
@pytest.mark.processes
@endless
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_a_killed_agent_costs_its_own_uav_alone_and_another_takes_its_place(
    number: signal.Signals, launched: Launched
) -> None:
    agents = launched.agents()
    assert len(agents) == 5
    assert {os.sched_getscheduler(p.pid) for p in agents} == {os.SCHED_BATCH}
    agents[2].send_signal(number)
    (lost,) = launched.told("lost", 1)
    (rejoined,) = launched.told("rejoined", 1)
    assert len(lost["uavs"]) == 1
    assert rejoined["uavs"] == lost["uavs"]
    another = launched.agents()[0]
    assert another not in agents
    assert os.sched_getscheduler(another.pid) == os.SCHED_BATCH
    summary = launched.interrupted()
    assert (summary["lost"], summary["nodes_lost"], summary["nodes_rejoined"]) == (0, 1, 1)


@linux
@pytest.mark.processes
@endless
def test_an_agent_that_dies_again_and_again_stays_away_and_the_others_fly_on(launched: Launched) -> None:
    for deaths in range(1, 7):
        if deaths > 1:
            launched.told("rejoined", deaths - 1)
        launched.agents()[0].kill()
        launched.told("lost", deaths)
    flown = spool_bytes(launched.out)
    until(lambda: spool_bytes(launched.out) > flown + 100_000, "the others fly on")
    summary = launched.interrupted()
    assert summary["lost"] == 1
    assert (summary["nodes_lost"], summary["nodes_rejoined"]) == (6, 5)


@linux
@pytest.mark.processes
def test_the_process_that_agents_are_forked_from_can_die_alone(launched: Launched, undisturbed: str) -> None:
    forked = launched.of("agent")
    agents = forked.children()
    forked.kill()
    summary = launched.summary()
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["nodes_lost"] == 0
    until(lambda: not any(map(alive, agents)), "all agents gone")


@pytest.mark.processes
@endless
def test_a_killed_leader_is_started_again(launched: Launched) -> None:
    launched.of("leader").kill()
    (rejoined,) = launched.told("rejoined", 1)
    assert rejoined["text"] == "leader.2 stands by"
    rounds = len(launched.told("round", 1))
    launched.told("round", rounds + 5)
    summary = launched.interrupted()
    assert (summary["lost"], summary["nodes_lost"], summary["nodes_rejoined"]) == (0, 1, 1)


@linux
@pytest.mark.processes
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_run_that_loses_all_agents_fails_and_is_resumed_from_before(
    number: signal.Signals, launched: Launched, undisturbed: str
) -> None:
    until(lambda: (launched.folder / CHECKPOINT).exists() and back(launched.folder).start.tick > 1, "a checkpoint")
    os.killpg(launched.of("agent").pid, number)
    _, err = launched.ended(1)
    assert "every agent is lost" in err
    (failed,) = launched.told("failed", 1)
    assert 101 <= back(launched.folder).start.tick <= failed["tick"]
    assert not (launched.folder / "summary.json").exists()
    assert main(["resume", str(launched.folder), "--in-process", "--no-record", "--json", "--quiet"]) == 0
    summary = json.loads((launched.folder / "summary.json").read_text())
    assert summary["trajectory_sha256"] == undisturbed
    assert (summary["lost"], summary["nodes_lost"]) == (0, 0)


@linux
@pytest.mark.processes
def test_a_stopped_launcher_costs_the_flight_nothing_and_has_the_whole_record_when_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undisturbed: str
) -> None:
    """As Ctrl-Z stops it: for longer than its lease, until the flight is over."""
    monkeypatch.setitem(ENVIRONMENT, LEASE, "3")
    with flying(tmp_path / "runs") as run:
        agents = run.agents()
        run.process.send_signal(signal.SIGSTOP)
        stopped_at = spool_bytes(run.out)
        until(lambda: not any(map(alive, agents)), "all agents gone home")
        assert spool_bytes(run.out) == stopped_at
        run.process.send_signal(signal.SIGCONT)
        summary = run.summary()
        assert (summary["trajectory_sha256"], summary["nodes_lost"]) == (undisturbed, 0)
        ticks = pq.read_table(run.folder / "timeseries.parquet", columns=["tick"])["tick"]
        assert ticks.to_pylist() == list(range(summary["ticks"] + 1))


@pytest.mark.processes
def test_where_nothing_is_forked_the_launcher_starts_an_agent_again_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


@linux
@pytest.mark.processes
def test_the_process_that_agents_are_forked_from_is_started_again_if_it_dies_before_it_forks(tmp_path: Path) -> None:
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


SHORT = 'duration = 100000\nstop = "duration"\nmethod = "mfg"'


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


def test_a_world_that_never_listens_is_a_matter_of_the_machine_and_not_of_a_flag_that_the_command_lacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nobody(timeout_s: float) -> None:
        raise BusError("the world is not there: start it, or wait longer (--wait)")

    monkeypatch.setattr("meanflock.groundstation.launch.run._CONNECT_S", 0.0)
    flown = scenarios.load(None, ["uavs=2", "duration=30", "method=mfg"])
    with RunFolder(tmp_path, "run", flown) as folder, Swarm("run") as swarm, Interrupted() as interrupted:
        monkeypatch.setattr(swarm, "check", lambda flying: None)
        monkeypatch.setattr(swarm, "connect", nobody)
        with pytest.raises(RunFailed, match=r"^after 0 s the world still cannot be reached: .*`meanflock doctor`$"):
            _connect(swarm, interrupted, folder)
