"""Real processes that are killed, frozen and cut off, over Zenoh on loopback."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.groundstation.recording.replay import recorded
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.net import keys
from meanflock.swarm.net.session import LEASE, ZenohBus
from tests.faults.conftest import SETTINGS, Flight, Lab, Processes, ends_by_itself, events_in, spool_bytes, summary_of
from tests.faults.wire import Wire
from tests.polling import DEADLINE_S, LINK_SURE_S, until

pytestmark = pytest.mark.processes


one_flight = pytest.mark.xdist_group("endless")  # and in this order


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """One flight for all who leave it as they found it: with an agent for every UAV."""
    swarm = Processes(f"endless-{os.getpid()}")
    yield Flight(swarm, tmp_path_factory.mktemp("endless"), barrier_s=5.0)
    swarm.close()


@one_flight
def test_a_killed_agent_is_lost_and_a_new_process_flies_its_uav_on(endless: Flight) -> None:
    losses, returns = endless.count("lost"), endless.count("rejoined")
    endless.flying()
    endless.agents[1].kill()
    assert endless.event("lost", losses + 1)["uavs"] == [1]
    endless.flying()
    endless.agents[1] = endless.processes.start("agent")
    assert endless.event("rejoined", returns + 1)["uavs"] == [1]
    endless.flying()


@one_flight
def test_a_frozen_agent_stalls_the_others_one_deadline_and_goes_home_when_it_wakes(endless: Flight) -> None:
    losses, returns = endless.count("lost"), endless.count("rejoined")
    endless.flying()
    frozen = endless.agents[2]
    frozen.send_signal(signal.SIGSTOP)
    since = time.monotonic()
    assert "no answer for 5 s" in endless.event("lost", losses + 1)["text"]
    endless.flying()
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
def test_a_successor_that_comes_before_its_predecessor_is_missed_waits_and_takes_over(endless: Flight) -> None:
    returns = endless.count("rejoined")
    endless.flying()
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
def test_after_all_that_nobody_is_missing_and_everyone_goes_home(endless: Flight) -> None:
    endless.flying()
    losses = endless.count("lost")
    summary = endless.end()
    assert (summary["lost"], summary["nodes_lost"]) == (0, losses)
    for process in (*endless.agents, *endless.leaders, endless.station):
        ends_by_itself(process)


def test_an_agent_cut_off_is_lost_when_its_lease_ends_though_the_barrier_would_wait_and_comes_back_when_it_can(
    processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LEASE, "4")
    wire = Wire(processes.base[1])
    try:
        flight = Flight(processes, tmp_path, barrier_s=300.0, agents=2)
        base = ("--endpoint", wire.endpoint, *processes.base[2:])
        far = processes.start("agent", "--uav", "2", base=base)
        flight.flying()
        wire.cut()
        lost = flight.event("lost")
        assert lost["uavs"] == [2]
        assert "liveliness" in lost["text"]
        flight.flying()
        wire.heal()
        assert flight.event("rejoined")["uavs"] == [2]
        flight.flying()
        summary = flight.end()
        assert (summary["lost"], summary["nodes_lost"]) == (0, 1)
        ends_by_itself(far)
    finally:
        wire.close()


def test_an_agent_and_a_leader_whose_connections_are_reset_come_back_and_end_only_when_the_world_is_gone(
    processes: Processes, tmp_path: Path
) -> None:
    wire = Wire(processes.base[1])
    try:
        flight = Flight(processes, tmp_path, agents=2, leaders=0)
        base = ("--endpoint", wire.endpoint, *processes.base[2:])
        patience = ("--wait", "12")
        far = [processes.start("agent", "--uav", "2", *patience, base=base)]
        far.append(processes.start("leader", *patience, base=base))
        flight.flying()
        for times in (1, 2):
            wire.reset()
            flight.event("lost", 2 * times)
            wire.heal()
            flight.event("rejoined", 2 * times)
            flight.flying()
        back = [event for folder in tmp_path.glob("*") for event in events_in(folder) if event["kind"] == "rejoined"]
        assert sorted(event["text"] for event in back) == [
            "agent-2.2 rejoined with UAV 2",
            "agent-2.3 rejoined with UAV 2",
            "leader.2 stands by",
            "leader.3 stands by",
        ]
        assert [process.poll() for process in far] == [None, None]
        flight.world.kill()
        since = time.monotonic()
        for process in far:
            _, err = process.communicate(timeout=DEADLINE_S)
            assert process.returncode == 1
            assert err.splitlines()[-1].startswith(f"error: the world of run {processes.base[3]!r} is gone; ")
        assert time.monotonic() - since < 30.0
        flight.agents[0].send_signal(signal.SIGTERM)  # it would wait for a minute
        ends_by_itself(flight.agents[0])
    finally:
        wire.close()


def test_a_standby_leader_takes_over_from_a_killed_one_and_the_flight_is_the_same(
    processes: Processes, tmp_path: Path
) -> None:
    settings = (*SETTINGS, "duration=450")
    expected = Lab(scenarios.load(None, settings)).fly()
    flight = Flight(processes, tmp_path, settings=settings, agents=2, leaders=0)
    watcher = ZenohBus.client(processes.base[1])
    try:
        watcher.watch(keys.alive(processes.base[3], "leader", "*"))
        for name in ("leader", "leader.2"):  # who joins first leads
            flight.leaders.append(flight.leader())
            token = keys.alive(processes.base[3], "leader", name)
            until(lambda token=token: (d := watcher.receive(0.1)) is not None and d.key == token, token)
    finally:
        watcher.close()
    processes.start("agent")
    flight.event("round", 3)
    flight.leaders[0].kill()
    summary = summary_of(flight.world)
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]
    assert summary["rounds"] == expected["rounds"] == 112
    ends_by_itself(flight.station)
    told = [event for folder in tmp_path.glob("*") for event in events_in(folder)]
    assert [event["tick"] for event in told if event["kind"] == "round"] == list(range(41, 4500, 40))
    assert [event["text"] for event in told if event["kind"] == "leader"] == ["leader.2 takes over from leader"]
    assert not [event for event in told if event["kind"] == "void"]


def test_a_killed_ground_station_that_is_started_again_leaves_no_gap_in_rows_and_events(
    processes: Processes, tmp_path: Path
) -> None:
    settings = (*SETTINGS, "duration=180")
    lab = Lab(scenarios.load(None, settings))
    lab.fly()
    flight = Flight(processes, tmp_path, settings=settings)
    for number in range(2):
        flight.flying(5_000)
        flight.station_again(signal.SIGTERM if number else signal.SIGKILL)
    summary = summary_of(flight.world)
    ends_by_itself(flight.station)
    (folder,) = tmp_path.iterdir()
    table = pq.read_table(folder / "timeseries.parquet")
    assert table["tick"].to_pylist() == list(range(1801))
    assert recorded([folder / "recording.rrd"]).ticks.tolist() == list(range(1801))
    expected = [(e.tick, e.kind, e.text) for e in lab.record.events if e.kind != "joined"]
    assert [(e["tick"], e["kind"], e["text"]) for e in events_in(folder) if e["kind"] != "joined"] == expected
    assert json.loads((folder / "summary.json").read_text())["trajectory_sha256"] == summary["trajectory_sha256"]
    assert summary["telemetry_blocks_dropped"] == 0


def test_a_frozen_agent_that_wakes_takes_its_own_place_again_if_nobody_has_it(
    processes: Processes, tmp_path: Path
) -> None:
    flight = Flight(processes, tmp_path, barrier_s=1.0)
    flight.flying()
    flight.agents[1].send_signal(signal.SIGSTOP)
    lost = flight.event("lost")
    flight.agents[1].send_signal(signal.SIGCONT)
    assert flight.event("rejoined")["uavs"] == lost["uavs"] == [1]
    flight.flying()
    assert flight.agents[1].poll() is None
    flight.end()
    ends_by_itself(flight.agents[1])


def test_a_station_whose_connection_is_reset_comes_back_and_leaves_no_gap(processes: Processes, tmp_path: Path) -> None:
    wire = Wire(processes.base[1])
    try:
        base = ("--endpoint", wire.endpoint, *processes.base[2:])
        world = processes.world("--stations", "1", settings=(*SETTINGS, "duration=300"))
        processes.start("agent", "--rows", "3")
        processes.start("leader")
        station = processes.station(tmp_path, base=base)
        for _ in range(2):
            rows = spool_bytes(tmp_path)
            until(lambda rows=rows: spool_bytes(tmp_path) > rows + 5_000, "telemetry")
            wire.reset()
            wire.heal()
        summary = summary_of(world)
        ends_by_itself(station)
        (folder,) = tmp_path.iterdir()
        assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(3001))
        assert json.loads((folder / "summary.json").read_text()) == summary
    finally:
        wire.close()


def test_a_frozen_agent_does_not_make_the_command_fail(tmp_path: Path) -> None:
    settings = [word for setting in (*SETTINGS, "duration=400") for word in ("--set", setting)]
    run = [
        "-m",
        "meanflock.groundstation.cli",
        "run",
        "--out",
        str(tmp_path),
        "--no-record",
        "--quiet",
        "--json",
        *settings,
    ]
    command = subprocess.Popen(
        [sys.executable, *run, "--endpoint", free_endpoint()],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "MEANFLOCK_BARRIER": "1"},
    )
    until(lambda: spool_bytes(tmp_path) > 5_000, "telemetry")
    family = psutil.Process(command.pid).children(recursive=True)
    frozen = next(p for p in family if "meanflock.agent" in p.cmdline() and not p.children())
    frozen.suspend()
    out, err = command.communicate(timeout=DEADLINE_S)
    assert command.returncode == 0, err
    summary = json.loads(out)
    assert (summary["ticks"], summary["lost"], summary["nodes_lost"]) == (4000, 1, 1)
    assert not frozen.is_running() or frozen.status() == psutil.STATUS_ZOMBIE
