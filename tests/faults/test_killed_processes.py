"""Kills of real processes: role × signal → the flight goes on, or is resumed to the end that it would have had.

The same in one process, tick by tick: test_kills.py. Every mishap of processes started by hand, under TLS:
tests/soak/mishaps.py.
"""

import json
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from meanflock.launch import certs
from meanflock.launch.forking import Forker
from meanflock.launch.processes import Swarm
from meanflock.launch.resume import back
from meanflock.net.session import LEASE
from meanflock.recording.replay import complete, recorded, verify
from meanflock.results.run_folder import CHECKPOINT
from meanflock.results.timeseries_file import past
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.errors import ProcessDied
from tests.controller_files import controller_file
from tests.faults.by_hand import ENDLESS, Flight, Processes, ends_by_itself, ticks_of
from tests.faults.conftest import honest
from tests.faults.dying import resumed
from tests.faults.launched import BARRIER_S, Launched, alive, launched
from tests.faults.wire import Wire
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.processes
forks = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")


# -- processes started by hand --------------------------------------------------------------------------------------


def test_nodes_of_a_killed_world_say_how_to_go_on_and_the_run_is_resumed_under_tls(processes, tmp_path) -> None:
    certs.init(tmp_path / "certs", 3)
    flown = (*ENDLESS, "method=mfgfl-h", "duration=200")
    processes.base += ("--wait", "20")  # so long nodes wait for a world that comes back
    flight = Flight(processes, tmp_path / "runs", settings=flown)
    flight.flying()
    until((flight.folder / CHECKPOINT).exists, "a checkpoint")
    flight.world.kill()
    for process in (*flight.agents, *flight.leaders, flight.station):
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 1, err
        assert re.search("^error: the world .*is gone.*meanflock resume", err.splitlines()[-1])
    folder = flight.folder
    summary = resumed(folder, "--tls", str(tmp_path / "certs"), in_process=False, record=True)
    for name in ("trajectory_sha256", "rounds", "ticks", "lost", "telemetry_blocks_dropped"):
        assert summary[name] == honest(scenarios.load(None, flown), name), name
    assert ticks_of(folder) == recorded([folder / "recording.rrd"]).ticks.tolist() == list(range(2001))
    assert len(flight.events("round")) == summary["rounds"]


@pytest.fixture
def wires(processes: Processes) -> Iterator[list[Wire]]:
    relays = [Wire(processes.base[1]) for _ in range(2)]
    yield relays
    for wire in relays:
        wire.close()


def test_nodes_whose_links_are_reset_or_cut_come_back_to_the_flight(processes, wires, tmp_path, monkeypatch) -> None:
    """The barrier would wait for five minutes; a node that is cut off is lost when its lease ends."""
    monkeypatch.setenv(LEASE, "4")
    near, of_station = (("--endpoint", wire.endpoint, *processes.base[2:]) for wire in wires)
    flight = Flight(processes, tmp_path, 300.0, agents=2, leaders=0, station_base=of_station)
    far = [processes.start("agent", "--uav", "2", base=near), processes.start("leader", base=near)]
    flight.flying()
    for times, fail in ((1, wires[0].reset), (2, wires[0].cut)):
        fail()
        assert "liveliness" in flight.event("lost", 2 * times)["text"]
        wires[1].reset()
        wires[1].heal()
        flight.flying()
        wires[0].heal()
        flight.event("rejoined", 2 * times)
    summary = flight.end()
    assert (summary["lost"], summary["nodes_lost"], summary["telemetry_blocks_dropped"]) == (0, 4, 0)
    for process in (*far, *flight.agents, flight.station):
        ends_by_itself(process)
    lives = (2, 3)
    expected = [f"agent-2.{life} rejoined with UAV 2" for life in lives] + [
        f"leader.{life} stands by" for life in lives
    ]
    assert sorted(event["text"] for event in flight.events("rejoined")) == expected
    assert ticks_of(flight.folder) == list(range(summary["ticks"] + 1))
    assert json.loads((flight.folder / "summary.json").read_text()) == summary


# -- processes of `meanflock run`: one endless run ------------------------------------------------------------------

# A learner, a leader, and a filter that remembers what UAVs heard of each other.
TICKS = 1500
_LEARNER = ("uavs=4", "seed=7", "federation.period=40", "method=fed-lspi", "filter.kind=ecbf", "start.spacing=2")
FLOWN = (*_LEARNER, f"duration={TICKS / 10}", "stop=duration")
of_command = pytest.mark.xdist_group("endless command")  # and in this order


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launched]:
    with launched(tmp_path_factory.mktemp("endless") / "runs", *FLOWN, "duration=100000", flags=()) as run:
        yield run


@forks
@of_command
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_the_command_starts_a_killed_agent_again(number: signal.Signals, command: Launched) -> None:
    losses, agents = command.count("lost"), command.forked("agent")
    assert len(agents) == 4
    agents[2].send_signal(number)
    lost = command.event("lost", losses + 1)
    rejoined = command.event("rejoined", losses + 1)
    assert len(lost["uavs"]) == 1
    assert rejoined["uavs"] == lost["uavs"]
    another = command.forked("agent")[0]
    assert another not in agents
    assert os.sched_getscheduler(another.pid) == os.SCHED_BATCH


@forks
@of_command
def test_the_command_starts_a_killed_leader_again(command: Launched) -> None:
    rejoins, rounds = command.count("rejoined"), command.count("round")
    command.forked("leader")[0].kill()
    assert command.event("rejoined", rejoins + 1)["text"] == "leader.2 stands by"
    command.event("round", rounds + 5)


@forks
@of_command
def test_the_command_gives_an_agent_up_that_dies_again_and_again(command: Launched) -> None:
    losses, rejoins = command.count("lost"), command.count("rejoined")
    for deaths in range(6):
        command.event("rejoined", rejoins + deaths)
        command.forked("agent")[0 if deaths else -1].kill()  # one that has never been started again, and then the same
        command.event("lost", losses + deaths + 1)
    command.flying(100_000)
    assert command.count("rejoined") == rejoins + 5


@forks
@of_command
def test_a_frozen_agent_costs_its_uav_and_ctrl_c_ends_the_flight_cleanly(command: Launched) -> None:
    losses, family = command.count("lost"), command.family()
    command.forked("agent")[0].suspend()
    assert f"no answer for {BARRIER_S} s" in command.event("lost", losses + 1)["text"]
    command.flying()
    command.process.send_signal(signal.SIGINT)
    _, err = command.ended(1)
    verdict = err.splitlines()[-1]
    assert verdict.startswith("error: interrupted")
    assert f"meanflock resume {command.folder}" in verdict
    assert not any(map(alive, family))
    summary = json.loads((command.folder / "summary.json").read_text())
    nodes = summary["nodes_lost"], summary["nodes_rejoined"]
    assert (summary["lost"], *nodes, summary["dropped_messages"]) == (2, losses + 1, losses - 1, {})
    assert ticks_of(command.folder) == list(range(summary["ticks"] + 1))
    assert verify(command.folder / "recording.rrd") is None


# -- runs of `meanflock run` that survive, or are resumed -----------------------------------------------------------

of_survivors = pytest.mark.xdist_group("survivors")  # they share the undisturbed flight


@forks
@of_survivors
def test_the_flight_does_not_need_its_launcher(tmp_path: Path) -> None:
    """It is stopped, as by Ctrl-Z, for longer than its lease, until the flight is over."""
    with launched(tmp_path / "runs", *FLOWN, **{LEASE: "3"}) as run:
        agents = run.forked("agent")
        run.process.send_signal(signal.SIGSTOP)
        until(lambda: not any(map(alive, agents)), "all agents gone home")
        run.process.send_signal(signal.SIGCONT)
        summary = json.loads(run.ended(0)[0])
        expected = honest(scenarios.load(None, FLOWN))
        assert (summary["trajectory_sha256"], summary["nodes_lost"]) == (expected, 0)
        assert ticks_of(run.folder) == list(range(TICKS + 1))


def interrupt_twice(run: Launched) -> None:
    """The first Ctrl-C waits for a frozen world."""
    run.forked("worldsim")[0].suspend()
    until(lambda: run.process.poll() is not None or run.process.send_signal(signal.SIGINT), "its end")


FORKER = "the process from which all others are forked"
KILLED = "was killed by SIGKILL, as the system does"
KILLS: dict[str, tuple[Callable[[Launched], object], int, str]] = {  # how, exit code and what the command says
    "world": (
        lambda run: run.forked("worldsim")[0].kill(),
        1,
        f"error: world {KILLED}",
    ),
    "forker": (lambda run: run.forker().kill(), 1, f"error: {FORKER} {KILLED}"),
    "launcher": (lambda run: run.process.kill(), -signal.SIGKILL, ""),
    "second Ctrl-C": (interrupt_twice, 1, "error: interrupted twice, nothing was completed; "),
}


@forks
@of_survivors
@pytest.mark.parametrize("victim", KILLS)
def test_a_run_that_is_killed_leaves_no_process_and_is_resumed_to_the_same_end(victim: str, tmp_path: Path) -> None:
    kill, code, says = KILLS[victim]
    record = victim == "launcher"
    with launched(tmp_path / "runs", *FLOWN, flags=() if record else ("--no-record",)) as run:
        folder = run.folder
        until(lambda: (folder / CHECKPOINT).exists() and back(folder).start.tick > 1, "a checkpoint of the flight")
        family = run.family()
        kill(run)
        out, err = run.ended(code)
        assert (out, says in err) == ("", True)
        assert not says or f"meanflock resume {folder}" in err.splitlines()[-1]
        until(lambda: not any(map(alive, family)), "all processes gone")
    assert 101 <= back(folder).start.tick < TICKS
    assert not (folder / "summary.json").exists()
    if record:
        looked_at = Path(shutil.copytree(folder, tmp_path / "looked at"))
        complete(looked_at)  # as `view` and `picture` do
        assert verify(looked_at / "recording.rrd") is None
        assert recorded([looked_at / "recording.rrd"]).ticks.tolist() == past(looked_at).rows["tick"].to_pylist()
    summary = resumed(folder, record=record)
    expected = honest(scenarios.load(None, FLOWN))
    assert (summary["trajectory_sha256"], summary["lost"], summary["nodes_lost"]) == (expected, 0, 0)
    assert ticks_of(folder) == list(range(TICKS + 1))
    assert not record or verify(folder / "recording.rrd") is None


@forks
@pytest.mark.parametrize("forked", [0, 1])
def test_a_forker_that_is_killed_before_take_off_ends_the_run(forked: int) -> None:
    with Forker() as forker, Swarm("unborn", forker=forker) as swarm:
        if forked:
            swarm.start_world("uavs = 2", wait_s=60.0, realtime=None)
            until(lambda: swarm.others_can_join(1.0), "a world that can be joined")
        family = psutil.Process(forker.process.pid).children()
        assert len(family) == forked
        forker.process.kill()  # while it loads what the others need, or when the world waits for them
        with pytest.raises(ProcessDied, match=f"^{FORKER} was killed by SIGKILL"):  # noqa: PT012
            swarm.start_agents([0, 1], 1, wait_s=60.0)
            until(swarm.check, "a look that fails")
    assert not any(map(alive, family))


def test_processes_are_started_one_by_one_where_a_plug_in_starts_a_thread(tmp_path: Path) -> None:
    """A killed agent is replaced all the same."""
    top = "import threading, time\nthreading.Thread(target=time.sleep, args=(1e6,), daemon=True).start()\n"
    plugin = controller_file(tmp_path, "threaded", "return mf.Step(memory, -0.02 * own[:, :2])", top)
    flags = ("--plugin", str(plugin), "--no-record")
    settings = ("method=threaded", "uavs=2", "duration=100000", "stop=duration")
    with launched(tmp_path / "runs", *settings, flags=flags) as run:
        started = psutil.Process(run.process.pid).children()
        modules = [next(word for word in process.cmdline() if word.startswith("meanflock.")) for process in started]
        assert sorted(modules) == ["meanflock.agent", "meanflock.agent", "meanflock.worldsim"]
        started[modules.index("meanflock.agent")].kill()
        run.event("rejoined")
        run.process.send_signal(signal.SIGINT)
        run.ended(1)
        assert not any(map(alive, started))
