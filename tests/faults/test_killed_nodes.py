"""Kills of processes that somebody started by hand: role × signal, with and without TLS, and over links that fail."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation import certs
from meanflock.groundstation.recording.replay import recorded
from meanflock.groundstation.results.run_folder import CHECKPOINT
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.net import keys
from meanflock.swarm.net.session import LEASE, ZenohBus
from tests.faults.conftest import SETTINGS, Flight, Lab, Processes, ends_by_itself, events_in, spool_bytes, summary_of
from tests.faults.dying import resumed
from tests.faults.wire import Wire
from tests.polling import DEADLINE_S, LINK_SURE_S, until

pytestmark = pytest.mark.processes

FLOWN, TICKS = (*SETTINGS, "duration=300"), 3000
one_flight = pytest.mark.xdist_group("endless")  # and in this order


# -- one endless flight, whole again after each test ----------------------------------------------------------------


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """A flight with an agent for every UAV, whose barrier is shorter than a lease."""
    swarm = Processes(f"endless-{os.getpid()}")
    yield Flight(swarm, tmp_path_factory.mktemp("endless"), barrier_s=3.0)
    swarm.close()


@one_flight
def test_a_new_process_takes_the_place_of_a_killed_agent(endless: Flight) -> None:
    losses, returns = endless.count("lost"), endless.count("rejoined")
    endless.flying()
    endless.agents[1].kill()
    assert endless.event("lost", losses + 1)["uavs"] == [1]
    endless.flying()
    endless.agents[1] = endless.processes.start("agent")
    assert endless.event("rejoined", returns + 1)["uavs"] == [1]
    endless.flying()


@one_flight
def test_a_frozen_agent_that_wakes_takes_its_own_place_again_if_no_other_has_it(endless: Flight) -> None:
    losses, returns = endless.count("lost"), endless.count("rejoined")
    endless.agents[1].send_signal(signal.SIGSTOP)
    lost = endless.event("lost", losses + 1)
    assert "no answer for 3 s" in lost["text"]
    endless.agents[1].send_signal(signal.SIGCONT)
    assert endless.event("rejoined", returns + 1)["uavs"] == lost["uavs"] == [1]
    endless.flying()
    assert endless.agents[1].poll() is None


@one_flight
def test_a_frozen_agent_that_wakes_goes_home_if_another_has_its_place(endless: Flight) -> None:
    losses, returns = endless.count("lost"), endless.count("rejoined")
    frozen, since = endless.agents[2], time.monotonic()
    frozen.send_signal(signal.SIGSTOP)
    endless.event("lost", losses + 1)
    endless.agents[2] = endless.processes.start("agent", "--uav", "2")
    endless.event("rejoined", returns + 1)
    frozen.send_signal(signal.SIGCONT)
    slept_s = time.monotonic() - since
    _, err = frozen.communicate(timeout=DEADLINE_S)
    if frozen.returncode != 0:  # it slept through its lease, comes back, and finds its place taken
        assert slept_s >= LINK_SURE_S
        assert "every UAV of this run has its agent already" in err
    endless.flying()


@one_flight
def test_a_successor_that_comes_too_early_waits_and_takes_over(endless: Flight) -> None:
    returns = endless.count("rejoined")
    patient = endless.processes.start("agent", "--uav", "0", env={"MEANFLOCK_LOG": "INFO"})
    hasty = endless.processes.start("agent", "--uav", "2", "--wait", "1")
    _, err = hasty.communicate(timeout=DEADLINE_S)
    assert hasty.returncode == 1
    assert err.strip() == "error: the world refused: every UAV of this run has its agent already"
    assert patient.stderr is not None
    assert "refused for now: " in patient.stderr.readline()
    endless.agents[0].kill()
    endless.agents[0] = patient
    assert endless.event("rejoined", returns + 1)["uavs"] == [0]
    endless.flying()


@one_flight
def test_a_second_station_is_sent_everything_while_the_first_is_frozen(endless: Flight, tmp_path: Path) -> None:
    endless.station.send_signal(signal.SIGSTOP)
    second = endless.processes.station(tmp_path)
    until(lambda: spool_bytes(tmp_path) > 20_000, "the second station records")
    endless.station.send_signal(signal.SIGCONT)
    second.terminate()
    second.communicate(timeout=DEADLINE_S)


@one_flight
def test_after_all_that_no_node_is_missing_and_each_ends_by_itself(endless: Flight) -> None:
    endless.flying()
    losses = endless.count("lost")
    summary = endless.end()
    assert (summary["lost"], summary["nodes_lost"]) == (0, losses)
    for process in (*endless.agents, *endless.leaders, endless.station):
        ends_by_itself(process)


# -- flights of their own -------------------------------------------------------------------------------------------


def told(out: Path) -> list[dict[str, Any]]:
    (folder,) = out.iterdir()
    return events_in(folder)


def test_a_killed_leader_and_killed_stations_cost_neither_a_round_nor_a_row(
    processes: Processes, tmp_path: Path
) -> None:
    lab = Lab(scenarios.load(None, FLOWN))
    expected = lab.fly()
    flight = Flight(processes, tmp_path, settings=FLOWN, agents=2, leaders=0)
    watcher = ZenohBus.client(processes.base[1])
    try:
        watcher.watch(keys.alive(processes.base[3], "leader", "*"))
        for name in ("leader", "leader.2"):  # the one that joins first leads
            flight.leaders.append(flight.leader())
            token = keys.alive(processes.base[3], "leader", name)
            until(lambda token=token: (d := watcher.receive(0.1)) is not None and d.key == token, token)
    finally:
        watcher.close()
    flight.agents.append(processes.start("agent"))
    flight.event("round", 3)
    flight.leaders[0].kill()
    for number in (signal.SIGKILL, signal.SIGTERM):
        flight.flying()
        flight.station_again(number)
    summary = summary_of(flight.world)
    ends_by_itself(flight.station)
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]
    assert (summary["rounds"], summary["telemetry_blocks_dropped"]) == (expected["rounds"], 0)
    (folder,) = tmp_path.iterdir()
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(TICKS + 1))
    assert recorded([folder / "recording.rrd"]).ticks.tolist() == list(range(TICKS + 1))
    assert json.loads((folder / "summary.json").read_text()) == summary
    kept = [(e["tick"], e["kind"], e["text"]) for e in told(tmp_path) if e["kind"] not in ("joined", "lost", "leader")]
    assert kept == [(e.tick, e.kind, e.text) for e in lab.record.events if e.kind != "joined"]
    assert [e["text"] for e in told(tmp_path) if e["kind"] == "leader"] == ["leader.2 takes over from leader"]


@pytest.fixture
def wires(processes: Processes) -> Iterator[list[Wire]]:
    """Two links to the world that can fail."""
    made = [Wire(processes.base[1]) for _ in range(2)]
    yield made
    for wire in made:
        wire.close()


def test_nodes_whose_links_are_reset_or_cut_come_back_to_a_flight_that_went_on(
    processes: Processes, wires: list[Wire], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The barrier would wait for five minutes; a node that is cut off is lost when its lease ends."""
    monkeypatch.setenv(LEASE, "4")
    near, of_station = ([*("--endpoint", wire.endpoint), *processes.base[2:]] for wire in wires)
    flight = Flight(processes, tmp_path, 300.0, agents=2, leaders=0, station_base=tuple(of_station))
    far = [processes.start("agent", "--uav", "2", base=tuple(near)), processes.start("leader", base=tuple(near))]
    flight.flying()
    for times, fail in ((1, wires[0].reset), (2, wires[0].cut), (3, wires[0].reset)):
        fail()
        assert "liveliness" in flight.event("lost", 2 * times)["text"]
        wires[1].reset()
        wires[1].heal()
        flight.flying()
        wires[0].heal()
        flight.event("rejoined", 2 * times)
    back = sorted(event["text"] for event in told(tmp_path) if event["kind"] == "rejoined")
    lives = range(2, 5)
    expected = [f"agent-2.{life} rejoined with UAV 2" for life in lives]
    assert back == expected + [f"leader.{life} stands by" for life in lives]
    summary = flight.end()
    assert (summary["lost"], summary["nodes_lost"], summary["telemetry_blocks_dropped"]) == (0, 6, 0)
    for process in (*far, *flight.agents, flight.station):
        ends_by_itself(process)
    (folder,) = tmp_path.iterdir()
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(summary["ticks"] + 1))
    assert json.loads((folder / "summary.json").read_text()) == summary


def test_under_tls_killed_nodes_come_back_with_their_certificates_and_a_killed_world_is_resumed(
    processes: Processes, tmp_path: Path
) -> None:
    certificates = tmp_path / "certs"
    certs.init(certificates, 3)
    processes.base += ("--tls", str(certificates))
    flight = Flight(processes, tmp_path / "runs", barrier_s=60.0, leaders=2, settings=FLOWN, patience=("--wait", "30"))
    for victim, flown in ((2, 40), (0, 90)):
        flight.reach(flown)
        flight.agents[victim].kill()
        flight.agents[victim] = processes.start("agent", "--uav", str(victim), "--wait", "30")
        assert flight.event("rejoined", 1 + (victim == 0))["uavs"] == [victim]
    flight.leaders.pop().kill()
    flight.leaders.append(processes.start("leader", "--wait", "30"))
    assert "stands by" in flight.event("rejoined", 3)["text"]
    flight.station_again(signal.SIGKILL)
    (folder,) = (tmp_path / "runs").iterdir()
    until((folder / CHECKPOINT).exists, "a checkpoint")
    flight.world.kill()
    for process in (*flight.agents, *flight.leaders, flight.station):
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 1, err
        assert err.splitlines()[-1].startswith("error: the world ")
        assert " is gone" in err
        assert "meanflock resume" in err
    summary = resumed(folder, "--tls", str(certificates), in_process=False)
    assert (summary["lost"], summary["ticks"]) == (0, TICKS)
    assert summary["dropped_messages"].keys() <= {"unknown-node"}  # last words of the dead: nobody was refused
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(TICKS + 1))
