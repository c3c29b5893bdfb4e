"""Attacks without a certificate of a node, with one, and with many sessions of one: what is not allowed is dropped."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import psutil
import pytest

from meanflock.bridge.observer import Observer
from meanflock.federation.plan import plan_of
from meanflock.launch.processes import free_endpoint
from meanflock.launch.station import StoredTelemetry
from meanflock.net import keys, tick
from meanflock.net.access import LEADER, OBSERVER, STATION, Identity, secured
from meanflock.net.limits import Limits, Quotas
from meanflock.net.session import _COMMON, ZenohBus, _config, _tls
from meanflock.swarm import scenario
from meanflock.swarm.errors import BusError
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Acknowledgement, Act, FrameKind, Frames, Join, Welcome
from tests.polling import DEADLINE_S, until
from tests.security.conftest import (
    HELD,
    HOLD_TICK,
    ME,
    PATIENCE_S,
    RUN,
    SETTINGS,
    VICTIM,
    Flight,
    Folders,
    act_in,
    forged,
)

pytestmark = pytest.mark.processes


def without_certificate(endpoint: str, folders: Folders) -> ZenohBus:
    """A client that believes the world's certificate and shows none."""
    settings = {
        **_COMMON,
        "mode": "client",
        "connect/endpoints": [secured(endpoint, Identity(folders.good, ME))],
        "connect/timeout_ms": int(PATIENCE_S * 1000),
        "connect/exit_on_failure": True,
        "transport/link/tls/root_ca_certificate": str(folders.good / "ca.pem"),
    }
    return ZenohBus(_config(settings))


def come_as_no_node(flight: Flight) -> ZenohBus:
    """Without a certificate of a node there is no link, or one over which nothing is allowed, which is returned."""
    folders = flight.folders
    with pytest.raises(BusError):
        without_certificate(flight.endpoint, folders)
    for folder in (folders.foreign, folders.expired):
        with pytest.raises(BusError, match="refuses"):
            ZenohBus.client(flight.endpoint, PATIENCE_S, Identity(folder, ME))
    with pytest.raises(BusError):
        ZenohBus.client(flight.endpoint, PATIENCE_S)  # not even TLS
    stranger = flight.client("agent-99", folders.stranger)
    for key in (keys.telemetry(RUN), keys.sense(RUN, "*")):
        stranger.subscribe(key)
    stranger.put(keys.act(RUN, VICTIM), forged())
    assert stranger.ask(keys.join(RUN, "agent-99"), control.encode(Join("agent", 1, 99)), PATIENCE_S) is None
    return stranger


def speak_for_others(flight: Flight, attacker: ZenohBus) -> None:
    session, told = attacker._session, control.encode(Acknowledgement(keys.fingerprint(RUN), 2**20))
    for key in (
        *(keys.act(RUN, name) for name in (VICTIM, f"{VICTIM}.2", "*", LEADER, OBSERVER)),
        *(f"{keys.ROOT}/**", keys.sense(RUN, VICTIM), keys.telemetry(RUN), keys.received(RUN), keys.observed(RUN)),
    ):
        session.put(key, forged())
        session.put(key, told)
    session.delete(keys.act(RUN, VICTIM))


def listen_to_others(spy: ZenohBus) -> None:
    listened = (keys.sense(RUN, VICTIM), keys.act(RUN, "*"), keys.act(RUN, VICTIM), keys.telemetry(RUN))
    for key in (*listened, keys.received(RUN)):
        spy.subscribe(key)
    spy.watch(keys.alive(RUN, "*", "*"))
    spy.answer(keys.join(RUN, VICTIM))  # to be asked what the world is asked


def send_a_global_model(flight: Flight, attacker: ZenohBus) -> None:
    poison = Frames(FrameKind.GLOBAL, 3, np.zeros(1, np.int32), np.full((1, 246), 7.0, np.float32))
    act = Act(keys.fingerprint(RUN), HOLD_TICK, np.zeros((0, 5)), outbox=(poison,))
    attacker.put(keys.act(RUN, LEADER), tick.write_act(act))
    attacker.put(keys.act(RUN, ME), tick.write_act(act))  # under its own name, where only the world can tell
    flight.logs(f"dropped a message under {keys.act(RUN, ME)}")


def join_for_others(flight: Flight, attacker: ZenohBus) -> None:
    victim, leader = Join("agent", 1, HELD), Join(LEADER, 0)
    for name, join in ((VICTIM, victim), (None, Join("agent", 1)), (LEADER, leader), (ME, victim)):
        key = keys.join(RUN) if name is None else keys.join(RUN, name)
        assert attacker.ask(key, control.encode(join), PATIENCE_S) is None
    flight.logs(f"dropped a message under {keys.join(RUN, ME)}")
    attacker.announce(keys.alive(RUN, "agent", VICTIM))


def replay(flight: Flight, attacker: ZenohBus) -> None:
    recorded = [raw for raw in flight.held.sent if act_in(raw) is not None]
    assert len(recorded) == HOLD_TICK
    thief = flight.client(VICTIM)  # with the victim's own key
    for raw in recorded:
        thief.put(keys.act(RUN, VICTIM), raw)
    flight.logs(f"reply to tick {HOLD_TICK - 1} in tick {HOLD_TICK}")


def connect_as_router(flight: Flight) -> ZenohBus:
    settings = {**_COMMON, "mode": "router", "listen/endpoints": [], "connect/exit_on_failure": True}
    me = Identity(flight.folders.good, ME)
    settings |= {"connect/endpoints": [secured(flight.endpoint, me)], **_tls(me, "connect")}
    attacker = ZenohBus(_config(settings))
    flight.opened.append(attacker)
    attacker.subscribe(f"{keys.ROOT}/{RUN}/**")

    def reached() -> bool:
        attacker.put(keys.act(RUN, ME), b"x")  # goes out once the world's subscription is known
        return f"dropped a message under {keys.act(RUN, ME)}: malformed" in flight.said()

    until(reached, "a message of its own in the world")
    attacker.put(keys.act(RUN, VICTIM), forged())
    return attacker


def test_an_attacker_can_neither_speak_nor_listen_nor_join_nor_die_for_a_node(flight: Flight, undisturbed: str) -> None:
    spy, attacker = flight.client(ME), flight.client(ME)
    listen_to_others(spy)
    for session in (spy, attacker):
        flight.settle(session, ME)  # from here on it knows where acts go
    stranger = come_as_no_node(flight)
    for attack in (speak_for_others, send_a_global_model, join_for_others, replay):
        attack(flight, attacker)
        flight.settle(attacker, ME)
    attacker.close()  # and the forged token with it
    router = connect_as_router(flight)
    flight.settle(router, ME)
    summary = flight.land()
    for session in (spy, stranger):
        assert session.receive(0.0) is None
    heard = {delivery.key for delivery in iter(lambda: router.receive(0.0), None)}
    own = {keys.act(RUN, ME), keys.act(RUN, VICTIM)}  # what it sent itself
    assert heard <= own | {keys.sense(RUN, ME)}
    assert (summary["trajectory_sha256"], summary["lost"], summary["nodes_lost"]) == (undisturbed, 0, 0)
    dropped = summary["dropped_messages"]
    assert dropped.pop("stale") >= HOLD_TICK
    assert dropped.pop("wrong-name") >= 1  # a question is asked again and again
    assert dropped.pop("malformed") >= 1
    assert dropped == {"wrong-shape": 1}


def test_no_node_can_pass_itself_off_as_the_world(folders: Folders) -> None:
    endpoint = free_endpoint()
    impostor = ZenohBus.router(endpoint, Identity(folders.good, ME))
    try:
        with pytest.raises(BusError):
            ZenohBus.client(endpoint, PATIENCE_S, Identity(folders.good, VICTIM))
    finally:
        impostor.close()


def test_an_observer_reads_the_telemetry_and_nothing_else_and_writes_nothing(flight: Flight, undisturbed: str) -> None:
    observer = Observer(flight.client(OBSERVER), DEADLINE_S)
    spy, attacker = flight.client(OBSERVER), flight.client(OBSERVER)
    listen_to_others(spy)
    speak_for_others(flight, attacker)
    for name, join in ((VICTIM, Join("agent", 1, HELD)), (LEADER, Join(LEADER, 0)), (STATION, Join(STATION, 0))):
        assert attacker.ask(keys.join(RUN, name), control.encode(join), PATIENCE_S) is None
    attacker.announce(keys.alive(RUN, "agent", VICTIM))
    attacker.announce(keys.alive(RUN, STATION, STATION))
    for session in (spy, attacker):
        answer = session.ask(keys.join(RUN, OBSERVER), control.encode(Join(OBSERVER, 0)), DEADLINE_S)
        assert answer is not None  # and the router has dealt with all that came before
        assert isinstance(control.decode(answer), Welcome)
    summary = flight.land()
    assert spy.receive(0.0) is None
    assert (summary["trajectory_sha256"], summary["lost"], summary["nodes_lost"]) == (undisturbed, 0, 0)
    assert set(summary["dropped_messages"]) <= {"wrong-key"}
    rows = StoredTelemetry()
    assert observer.listen(rows)["trajectory_sha256"] == undisturbed
    ticks = np.concatenate([block.first_tick + np.arange(len(block.states)) for block in rows.blocks])
    assert ticks.tolist() == list(range(ticks[0], summary["ticks"] + 1))
    assert ticks[0] <= HOLD_TICK


FLOWN = scenario.load(None, SETTINGS)
LONGEST = Quotas(RUN, FLOWN, Limits(plan_of(FLOWN)), rows_at_most=1).largest  # bytes of a message of anyone
PROCESSES, SESSIONS, MEGABYTES = 5, 2, 60
MOST_MB = 200


FLOODS = """
import os, sys, threading
from pathlib import Path
from meanflock.net.access import Identity
from meanflock.net.session import ZenohBus

endpoint, folder, name, key, sessions, megabytes = sys.argv[1:]

def flood():
    bus = ZenohBus.client(endpoint, 180.0, Identity(Path(folder), name))
    os.write(1, b"begun\\n")  # in one piece, beside the other session's
    while True:
        bus.put(key, bytes(int(megabytes) * 10**6))

for _ in range(int(sessions)):
    threading.Thread(target=flood).start()
"""


@contextmanager
def flood(flight: Flight) -> Iterator[None]:
    """Ten sessions in five processes, from when all of them send."""
    where = [flight.endpoint, str(flight.folders.good), ME, keys.act(RUN, ME), str(SESSIONS), str(MEGABYTES)]
    command = [sys.executable, "-c", FLOODS, *where]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(PROCESSES)]
    try:
        for process in processes:
            assert [process.stdout.readline() for _ in range(SESSIONS)] == [b"begun\n"] * SESSIONS
        yield
        assert all(process.poll() is None for process in processes)
    finally:
        for process in processes:
            process.kill()
            process.wait()
            process.stdout.close()


@pytest.fixture
def memory_mb(flight: Flight) -> Iterator[list[float]]:
    world, ended, measured = psutil.Process(flight.world.pid), threading.Event(), [0.0]

    def watch() -> None:
        with suppress(psutil.NoSuchProcess):
            while not ended.wait(0.01):
                measured.append(world.memory_info().rss / 2**20)

    thread = threading.Thread(target=watch)
    thread.start()
    yield measured
    ended.set()
    thread.join()


def test_a_flood_of_too_long_messages_costs_neither_the_flight_nor_memory(flight, undisturbed, memory_mb) -> None:
    """Those of many sessions do not even reach the world; those that are hardly too long are counted."""
    ended, attacker = threading.Event(), flight.client(ME)

    def send() -> None:
        while not ended.is_set():
            attacker.put(keys.act(RUN, ME), bytes(LONGEST + 500))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        until(lambda: flight.said().count("oversized") >= 50, "fifty messages dropped")
        with flood(flight):
            summary = flight.land()  # while it goes on
    finally:
        ended.set()
        thread.join()
    assert summary["dropped_messages"]["oversized"] >= 50
    assert (summary["trajectory_sha256"], summary["lost"]) == (undisturbed, 0)
    assert max(memory_mb) < MOST_MB
