"""Kills of `meanflock run` and of its processes: role × signal → the run survives, or is resumed to the same end."""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.launch.resume import back
from meanflock.groundstation.recording.replay import verify
from meanflock.groundstation.results.run_folder import CHECKPOINT
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.net.session import LEASE
from tests.faults.conftest import Lab, events_in
from tests.faults.dying import resumed
from tests.faults.launched import BARRIER_S, Launched, alive, launched
from tests.polling import DEADLINE_S, until

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(sys.platform != "linux", reason="agents are forked on Linux only"),
]
# A learner, a leader, and a filter that remembers what UAVs heard of each other.
TICKS = 2000
_LEARNER = ("uavs=4", "seed=7", "federation.period=40", "method=fed-lspi", "filter.kind=ecbf", "start.spacing=2")
FLOWN = (*_LEARNER, f"duration={TICKS / 10}", "stop=duration")
one_flight = pytest.mark.xdist_group("endless command")  # and in this order


@pytest.fixture(scope="module")
def undisturbed() -> str:
    """The hash of `FLOWN` if nothing happens."""
    return str(Lab(scenarios.load(None, FLOWN)).fly()["trajectory_sha256"])


# -- an endless run whose nodes are hurt one after the other ---------------------------------------------------------


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launched]:
    with launched(tmp_path_factory.mktemp("endless") / "runs", *FLOWN, "duration=100000") as run:
        yield run


def count(run: Launched, kind: str) -> int:
    return sum(event["kind"] == kind for event in events_in(run.folder))


@one_flight
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_the_command_starts_a_killed_agent_again(number: signal.Signals, endless: Launched) -> None:
    losses, agents = count(endless, "lost"), endless.agents()
    assert len(agents) == 4
    agents[2].send_signal(number)
    lost = endless.events("lost", losses + 1)[-1]
    rejoined = endless.events("rejoined", losses + 1)[-1]
    assert len(lost["uavs"]) == 1
    assert rejoined["uavs"] == lost["uavs"]
    another = endless.agents()[0]
    assert another not in agents
    assert os.sched_getscheduler(another.pid) == os.SCHED_BATCH


@one_flight
def test_the_command_starts_a_killed_leader_again(endless: Launched) -> None:
    rejoins, rounds = count(endless, "rejoined"), count(endless, "round")
    endless.child("leader").kill()
    assert endless.events("rejoined", rejoins + 1)[-1]["text"] == "leader.2 stands by"
    endless.events("round", rounds + 5)


@one_flight
def test_the_command_gives_an_agent_up_that_dies_again_and_again(endless: Launched) -> None:
    losses, rejoins = count(endless, "lost"), count(endless, "rejoined")
    for deaths in range(6):
        endless.events("rejoined", rejoins + deaths)
        endless.agents()[0 if deaths else -1].kill()  # one that has never been started again, and then the same
        endless.events("lost", losses + deaths + 1)
    endless.flying(100_000)
    assert count(endless, "rejoined") == rejoins + 5


@one_flight
def test_a_frozen_agent_costs_its_uav_and_not_the_command(endless: Launched) -> None:
    losses = count(endless, "lost")
    frozen = endless.agents()[0]
    frozen.suspend()
    assert f"no answer for {BARRIER_S} s" in endless.events("lost", losses + 1)[-1]["text"]
    endless.flying()
    summary = endless.interrupt()
    nodes = summary["nodes_lost"], summary["nodes_rejoined"]
    assert (summary["lost"], *nodes, summary["dropped_messages"]) == (2, losses + 1, losses - 1, {})
    assert not alive(frozen)


# -- runs that survive, or are resumed ------------------------------------------------------------------------------


def test_the_flight_needs_neither_its_launcher_nor_the_process_that_agents_are_forked_from(
    tmp_path: Path, undisturbed: str
) -> None:
    """The launcher is stopped, as by Ctrl-Z, for longer than its lease, until the flight is over."""
    with launched(tmp_path / "runs", *FLOWN, **{LEASE: "3"}) as run:
        forked = run.child("agent")
        agents = forked.children()
        forked.kill()
        run.process.send_signal(signal.SIGSTOP)
        until(lambda: not any(map(alive, agents)), "all agents gone home")
        run.process.send_signal(signal.SIGCONT)
        summary = json.loads(run.ended(0)[0])
        assert (summary["trajectory_sha256"], summary["nodes_lost"]) == (undisturbed, 0)
        ticks = pq.read_table(run.folder / "timeseries.parquet", columns=["tick"])["tick"]
        assert ticks.to_pylist() == list(range(summary["ticks"] + 1))


KILLS: dict[str, tuple[Callable[[Launched], object], int, str]] = {  # how, exit code and what the command says
    "world": (lambda run: run.child("worldsim").kill(), 1, "error: world was killed by SIGKILL, as the system does"),
    "all agents": (lambda run: os.killpg(run.child("agent").pid, signal.SIGKILL), 1, "every agent is lost"),
    "launcher": (lambda run: run.process.kill(), -signal.SIGKILL, ""),
}


@pytest.mark.parametrize(
    ("victim", "in_process", "record"),
    [("world", False, True), ("all agents", True, False), ("launcher", True, True)],
)
def test_a_run_that_is_killed_leaves_no_process_and_is_resumed_to_the_same_end(
    victim: str, in_process: bool, record: bool, tmp_path: Path, undisturbed: str
) -> None:
    kill, code, says = KILLS[victim]
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
    summary = resumed(folder, in_process=in_process, record=record)
    assert (summary["trajectory_sha256"], summary["lost"], summary["nodes_lost"]) == (undisturbed, 0, 0)
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(TICKS + 1))
    assert not record or verify(folder / "recording.rrd") is None


@pytest.mark.parametrize("flags", [(), ("--in-process",)], ids=["processes", "one process"])
def test_an_interrupted_run_ends_cleanly_and_keeps_its_flight(flags: tuple[str, ...], tmp_path: Path) -> None:
    with launched(tmp_path / "runs", *FLOWN, "duration=100000", flags=flags) as run:
        family = run.family()
        run.process.send_signal(signal.SIGINT)
        _, err = run.ended(1)
        again = "resume {}" if (run.folder / CHECKPOINT).exists() else "run {}/scenario.toml"
        assert (err.strip().count("\n"), "interrupted" in err) == (0, True)
        assert f"meanflock {again.format(run.folder)}" in err
        assert not any(map(alive, family))
        table = pq.read_table(run.folder / "timeseries.parquet")
        assert table["tick"].to_pylist() == list(range(len(table)))
        assert json.loads((run.folder / "summary.json").read_text())["ticks"] == len(table) - 1
        assert verify(run.folder / "recording.rrd") is None


def test_a_second_ctrl_c_ends_the_run_at_once_and_kills_a_frozen_world(tmp_path: Path) -> None:
    with launched(tmp_path / "runs", *FLOWN, "duration=100000") as run:
        family = run.family()
        run.child("worldsim").suspend()  # the first Ctrl-C waits for it
        until(lambda: run.process.poll() is not None or run.process.send_signal(signal.SIGINT), "its end")
        _, err = run.ended(1)
        assert err.startswith("error: interrupted twice, nothing was completed; ")
        assert f"{run.folder}/scenario.toml" in err or f"meanflock resume {run.folder}" in err
        until(lambda: not any(map(alive, family)), "the end of all processes", DEADLINE_S)
