"""A node with a genuine certificate that attacks: the router or the world drops what it may not send."""

import threading

import numpy as np
import pytest

from meanflock.swarm import scenario
from meanflock.swarm.net import keys
from meanflock.swarm.net.access import LEADER, Identity
from meanflock.swarm.net.address import secured
from meanflock.swarm.net.session import _COMMON, ZenohBus, _config, _tls
from meanflock.swarm.wire import control, tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Join, Ready
from meanflock.worldsim.limits import Limits, Quotas
from tests.polling import DEADLINE_S, until
from tests.security.attacks import ME, PATIENCE_S, VICTIM, forged
from tests.security.conftest import HELD, HOLD_TICK, RUN, SETTINGS, Flight, act_in

pytestmark = pytest.mark.processes
FLOWN = scenario.load(None, SETTINGS)
LONGEST = Quotas(RUN, FLOWN, Limits(FLOWN), rows_at_most=1).largest  # bytes of a message of anyone


def test_without_tls_the_forged_act_is_taken_for_real(open_flight: Flight, undisturbed: str) -> None:
    """The attack of the next test is one: nothing but the access-control list stands against it."""
    publisher = open_flight.client(ME)
    publisher.put(keys.act(RUN, VICTIM), control.encode(Ready(keys.fingerprint(RUN))))
    publisher.put(keys.act(RUN, VICTIM), forged())
    publisher.ask(keys.join(RUN, ME), control.encode(Join("agent", 1, 3)), DEADLINE_S)  # what came before has arrived
    assert open_flight.land()["trajectory_sha256"] != undisturbed


def test_agent_3_publishing_as_agent_4_is_denied(flight: Flight, undisturbed: str) -> None:
    attacker = flight.client(ME)
    flight.settle(attacker, ME)  # from here on its session knows where acts go
    attacker.put(keys.act(RUN, VICTIM), forged())
    raw = attacker._session
    raw.put(keys.act(RUN, VICTIM), forged())
    raw.put(keys.act(RUN, "*"), forged())
    raw.put(keys.act(RUN, f"{VICTIM}.2"), forged())
    raw.put(f"{keys.ROOT}/**", forged())
    raw.put(keys.sense(RUN, VICTIM), forged())
    raw.put(keys.telemetry(RUN), forged())
    raw.put(keys.received(RUN), forged())
    raw.delete(keys.act(RUN, VICTIM))
    flight.settle(attacker, ME)
    summary = flight.land()
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["dropped_messages"] == {}


def test_an_agent_subscribing_to_anothers_sense_hears_nothing(flight: Flight, undisturbed: str) -> None:
    spy = flight.client(ME)
    for key in (keys.sense(RUN, VICTIM), keys.act(RUN, "*"), keys.telemetry(RUN), keys.act(RUN, VICTIM)):
        spy.subscribe(key)
    spy.watch(keys.alive(RUN, "*", "*"))
    spy.answer(keys.join(RUN, VICTIM))  # to be asked what the world is asked
    flight.settle(spy, ME)
    summary = flight.land()
    assert spy.receive(0.0) is None
    assert summary["trajectory_sha256"] == undisturbed


@pytest.mark.parametrize("mode", ["router", "peer"])
def test_an_agent_that_connects_as_a_router_may_no_more(flight: Flight, undisturbed: str, mode: str) -> None:
    settings = {**_COMMON, "mode": mode, "listen/endpoints": [], "connect/exit_on_failure": True}
    me = Identity(flight.certificates, ME)
    settings |= {"connect/endpoints": [secured(flight.endpoint, me)], **_tls(me, "connect")}
    attacker = ZenohBus(_config(settings))
    flight.opened.append(attacker)
    attacker.subscribe(f"{keys.ROOT}/{RUN}/**")

    def reached() -> bool:
        attacker.put(keys.act(RUN, ME), b"x")  # goes out once the world's subscription is known
        return f"dropped a message under {keys.act(RUN, ME)}" in flight.said()

    until(reached, "a message of its own in the world")
    attacker.put(keys.act(RUN, VICTIM), forged())
    flight.settle(attacker, ME)
    assert flight.land()["trajectory_sha256"] == undisturbed
    heard = set()
    while (delivery := attacker.receive(0.0)) is not None:
        heard.add(delivery.key)
    own = {keys.act(RUN, ME), keys.act(RUN, VICTIM)}  # what it sent itself
    assert heard <= own | {keys.sense(RUN, ME)}


def test_an_agent_sending_as_leader_is_denied(flight: Flight, undisturbed: str) -> None:
    attacker = flight.client(ME)
    model = np.full((1, 246), 7.0, np.float32)
    poison = Frames(FrameKind.GLOBAL, 3, np.zeros(1, np.int32), model)
    act = Act(keys.fingerprint(RUN), HOLD_TICK, np.zeros((0, 5)), outbox=(poison,))
    attacker.put(keys.act(RUN, LEADER), tick.write_act(act))
    attacker.put(keys.act(RUN, ME), tick.write_act(act))  # and under its own name, where only the world can tell
    assert attacker.ask(keys.join(RUN, LEADER), control.encode(Join(LEADER, 0)), PATIENCE_S) is None
    flight.logs(f"dropped a message under {keys.act(RUN, ME)}")
    summary = flight.land()
    assert summary["dropped_messages"]["wrong-shape"] == 1
    assert summary["trajectory_sha256"] == undisturbed


def test_nobody_joins_or_lives_or_dies_in_anothers_name(flight: Flight, undisturbed: str) -> None:
    attacker = flight.client(ME)
    assert attacker.ask(keys.join(RUN, VICTIM), control.encode(Join("agent", 1, HELD)), PATIENCE_S) is None
    assert attacker.ask(keys.join(RUN), control.encode(Join("agent", 1)), PATIENCE_S) is None
    assert attacker.ask(keys.join(RUN, ME), control.encode(Join("agent", 1, HELD)), PATIENCE_S) is None
    flight.logs(f"dropped a message under {keys.join(RUN, ME)}")
    attacker.announce(keys.alive(RUN, "agent", VICTIM))
    flight.settle(attacker, ME)
    attacker.close()  # and the forged token with it
    summary = flight.land()
    assert summary["lost"] == 0
    assert summary["dropped_messages"]["wrong-name"] >= 1
    assert summary["trajectory_sha256"] == undisturbed


WILD = ["**", "*/**", f"{keys.ROOT}/**", f"{keys.ROOT}/{RUN}/**", keys.act(RUN, "*"), keys.act(RUN, "a$*"), "**/act"]


def test_without_tls_no_key_ends_the_world(open_flight: Flight, undisturbed: str) -> None:
    attacker = open_flight.client(ME)._session
    forged_line = keys.act(RUN, f"x\n2026-01-01 00:00:00,000 meanflock.world WARNING lost {VICTIM}: it cheats\x1b[2J")
    tokens = []
    for key in (*WILD, forged_line):
        attacker.put(key, b"x")
        attacker.delete(key)
        tokens.append(attacker.liveliness().declare_token(key.replace("node", "alive")))
        list(attacker.get(key, payload=control.encode(Join("agent", 1)), timeout=PATIENCE_S))
    open_flight.logs("dropped a message under **: wrong-key", "\\n2026-01-01")
    summary = open_flight.land()
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["dropped_messages"]["wrong-key"] >= len(WILD)
    assert all(line.isprintable() for line in open_flight.said().split("\n"))
    assert not [line for line in open_flight.said().split("\n") if line.endswith("it cheats") or "lost" in line[:60]]


# -- who has the right certificate and means ill --------------------------------------------------------------------


def test_replayed_frames_are_dropped(flight: Flight, undisturbed: str) -> None:
    thief = flight.client(VICTIM)  # with the victim's own key
    recorded = [raw for raw in flight.held.sent if act_in(raw) is not None]
    assert len(recorded) == HOLD_TICK
    for raw in recorded:
        thief.put(keys.act(RUN, VICTIM), raw)
    flight.logs(f"reply to tick {HOLD_TICK - 1} in tick {HOLD_TICK}")
    summary = flight.land()
    assert summary["dropped_messages"]["stale"] >= HOLD_TICK
    assert summary["trajectory_sha256"] == undisturbed


def test_a_flood_of_oversize_frames_costs_neither_the_flight_nor_the_memory(flight: Flight, undisturbed: str) -> None:
    attacker = flight.client(ME)
    most, ended = [flight.rss_mb()], threading.Event()
    before = most[0]

    def flood() -> None:
        frame = bytes(LONGEST + 500)  # what is longer by a kilobyte does not even reach the world
        while not ended.is_set():
            attacker.put(keys.act(RUN, ME), frame)

    def watch() -> bool:
        most.append(flight.rss_mb())
        return flight.said().count("oversized") >= 50

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        until(watch, "fifty frames dropped")
        summary = flight.land()  # while it goes on
    finally:
        ended.set()
        thread.join()
    assert summary["dropped_messages"]["oversized"] >= 50
    assert summary["lost"] == 0
    assert summary["trajectory_sha256"] == undisturbed
    assert max(most) - before < 200, "MB more than before the flood"
