"""Real processes that are killed, frozen and cut off, over Zenoh on loopback."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from groundstation.launch import free_endpoint
from groundstation.recorded import recorded
from swarm import keys
from swarm import scenario as scenarios
from swarm.session import ZenohBus
from tests.faults.conftest import SETTINGS, Flight, Lab, Processes, ends_by_itself, events_in, spool_bytes, summary_of
from tests.polling import DEADLINE_S, LINK_SURE_S, until

pytestmark = pytest.mark.processes


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """One flight for all who leave it as they found it: with an agent for every UAV."""
    swarm = Processes(f"endless-{os.getpid()}")
    yield Flight(swarm, tmp_path_factory.mktemp("endless"), barrier_s=5.0)
    swarm.close()


def test_a_killed_agent_is_lost_and_a_new_process_flies_its_uav_on(endless: Flight) -> None:
    losses, returns = endless.count("lost"), endless.count("rejoined")
    endless.flying()
    endless.agents[1].kill()
    assert endless.event("lost", losses + 1)["uavs"] == [1]
    endless.flying()
    endless.agents[1] = endless.processes.start("agent")
    assert endless.event("rejoined", returns + 1)["uavs"] == [1]
    endless.flying()


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
    if frozen.returncode != 0:  # it slept through its lease, and takes its closed link for a world that is gone
        assert slept_s >= LINK_SURE_S
        assert "is gone" in err
    endless.flying()


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


def test_after_all_that_nobody_is_missing_and_everyone_goes_home(endless: Flight) -> None:
    endless.flying()
    losses = endless.count("lost")
    summary = endless.end()
    assert (summary["lost"], summary["nodes_lost"]) == (0, losses)
    for process in (*endless.agents, *endless.leaders, endless.station):
        ends_by_itself(process)


class Wire:
    """A TCP relay that can be cut: nothing passes, and neither side is told."""

    def __init__(self, endpoint: str) -> None:
        self._to = ("127.0.0.1", int(endpoint.rpartition(":")[2]))
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._pairs: dict[socket.socket, socket.socket] = {}
        self._open = threading.Event()
        self._open.set()
        self._over = False
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        self._open.clear()

    def heal(self) -> None:
        self._open.set()

    def close(self) -> None:
        self._over = True
        self._open.set()
        self._thread.join()
        for end in (self._server, *self._pairs):
            end.close()

    def _relay(self) -> None:
        while not self._over:
            self._open.wait()
            for ready in select.select([self._server, *self._pairs], [], [], 0.05)[0]:
                if not self._open.is_set():
                    break
                if ready is self._server:
                    near = self._server.accept()[0]
                    try:
                        far = socket.create_connection(self._to, 5.0)
                    except OSError:
                        near.close()
                        continue
                    self._pairs.update({near: far, far: near})
                elif ready in self._pairs:
                    self._pass(ready)

    def _pass(self, ready: socket.socket) -> None:
        other = self._pairs[ready]
        try:
            if data := ready.recv(1 << 16):
                other.sendall(data)
                return
        except OSError:
            pass
        for end in (ready, other):
            self._pairs.pop(end, None)
            end.close()


def test_an_agent_cut_off_from_the_world_is_lost_when_its_lease_ends_though_the_barrier_would_wait(
    processes: Processes, tmp_path: Path
) -> None:
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
        _, err = far.communicate(timeout=DEADLINE_S)
        assert far.returncode == 0 or "is gone" in err  # whose lease ends first: told that it is lost, or sees no world
        assert flight.end()["lost"] == 1
    finally:
        wire.close()


def test_a_standby_leader_takes_over_from_a_killed_one_and_the_flight_is_the_same(
    processes: Processes, tmp_path: Path
) -> None:
    settings = (*SETTINGS, "duration=150")
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
    assert summary["rounds"] == expected["rounds"] == 37
    ends_by_itself(flight.station)
    told = [event for folder in tmp_path.glob("*") for event in events_in(folder)]
    assert [event["tick"] for event in told if event["kind"] == "round"] == list(range(41, 1500, 40))
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
    expected = [(e.tick, e.kind, e.text) for e in lab.told.events if e.kind != "joined"]
    assert [(e["tick"], e["kind"], e["text"]) for e in events_in(folder) if e["kind"] != "joined"] == expected
    assert json.loads((folder / "summary.json").read_text())["trajectory_sha256"] == summary["trajectory_sha256"]
    assert summary["telemetry_blocks_dropped"] == 0


def test_a_frozen_agent_does_not_make_the_command_fail(tmp_path: Path) -> None:
    settings = [word for setting in (*SETTINGS, "duration=100") for word in ("--set", setting)]
    run = ["-m", "groundstation.cli", "run", "--out", str(tmp_path), "--no-record", "--quiet", "--json", *settings]
    command = subprocess.Popen(
        [sys.executable, *run, "--endpoint", free_endpoint()],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "MEANFLOCK_BARRIER": "1"},
    )
    until(lambda: spool_bytes(tmp_path) > 5_000, "telemetry")
    family = psutil.Process(command.pid).children(recursive=True)
    frozen = next(p for p in family if "agent" in p.cmdline() and not p.children())
    frozen.suspend()
    out, err = command.communicate(timeout=DEADLINE_S)
    assert command.returncode == 0, err
    summary = json.loads(out)
    assert (summary["ticks"], summary["lost"], summary["nodes_lost"]) == (1000, 1, 1)
    assert not frozen.is_running() or frozen.status() == psutil.STATUS_ZOMBIE
