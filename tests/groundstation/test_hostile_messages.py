"""Floods, refused joins and keys that no node uses. Malformed messages: tests/faults/test_hostile_input.py."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Event, Join, Refusal
from tests.faults.conftest import RUN, scenario
from tests.golden.flights import steady


@pytest.mark.parametrize(
    ("node", "dropped", "kind", "logged"),
    [
        ("agent-7", {"unknown-node": 600}, "dropped", 100),
        ("agent-0", {"oversized": 600 - 102}, "agent", 102),  # 100 events, and one for each of its UAVs
    ],
)
def test_a_flood_is_counted_and_logged_up_to_a_limit(node, dropped, kind, logged) -> None:
    kept = Kept()
    engine = Engine(scenario("duration=3", method="mfg"), RUN, sinks=[kept], uavs_per_node=2)
    for tick in engine.fly():
        message = b"\xc1" if kind == "dropped" else control.encode(Event(tick, "failed", "again"))
        for _ in range(20):
            engine.world.handle(Delivery("message", keys.act(RUN, node), message))
    assert engine.world.finish()["dropped_messages"] == dropped
    events = [event.kind for block in kept.blocks for event in block.events]
    assert (events.count(kind), events.count("dropped")) == (logged, 100)


JOINS = [Join("agent", 1), Join("agent", 1, 2), Join("agent", 2**63, 2**63), Join("agent", 0), Join("agent", -5)]


@pytest.mark.parametrize("join", [*JOINS, Join("leader", 0), Join("pirate", 1)])
def test_a_join_without_a_free_place_is_refused_with_a_reason(join: Join) -> None:
    engine, replies = Engine(scenario("duration=2", method="mfg"), RUN), []
    key = keys.join(RUN, keys.requested_name(join.role, join.uav))
    engine.world.handle(Delivery("question", key, control.encode(join), replies.append))
    (answer,) = (control.decode(raw) for raw in replies)
    assert isinstance(answer, Refusal)
    assert answer.reason
    assert answer.for_now == ("its agent already" in answer.reason)  # that agent may be lost later


SUFFIXES = (
    *("", "/**", "/node", "/node//act", "/node/*/act", "/node/$*/act", "/node/agent-1/**", "/node/agent-1/act\n"),
    *("/node/agent-1\x1b[2J/act", "/node/agent-1\nlost agent-2/act", "/node/\u202eagent-1/act"),
    *("/alive", "/alive/agent/\x1b]0;x\x07", "/alive/**"),
)
HOSTILE_KEYS = ["", "/", "**", "*", "x", f"{keys.ROOT}/**", "a/" * 20_000]
HOSTILE_KEYS += [f"{keys.ROOT}/{RUN}{suffix}" for suffix in SUFFIXES]


def test_a_hostile_key_is_dropped_escaped_and_changes_nothing(caplog: pytest.LogCaptureFixture) -> None:
    flown = scenario("duration=2", method="mfg")
    honest, kept = Engine(flown, RUN).complete(), Kept()
    engine, replies = Engine(flown, RUN, sinks=[kept]), []
    question = control.encode(Join("agent", 1))
    for tick in engine.fly():
        if tick != 4:
            continue
        for key in (keys.act(RUN, "agent-0"), keys.received(RUN)):
            engine.world.handle(Delivery("oversized", key, size=70, largest=64))
            assert caplog.messages[-1].endswith("oversized: 70 bytes, at most 64 expected")
        for key in HOSTILE_KEYS:
            for delivery in (
                Delivery("message", key, b"x"),
                Delivery("question", key, question, replies.append),
                Delivery("alive", key),
                Delivery("gone", key),
                Delivery("oversized", key, size=1),
            ):
                before = engine.world.counters.drops.total()
                engine.world.handle(delivery)
                assert engine.world.counters.drops.total() == before + 1, delivery
    summary = engine.world.finish()
    assert summary["dropped_messages"] == {"wrong-key": 5 * len(HOSTILE_KEYS), "oversized": 2}
    assert not replies
    texts = [event.text for block in kept.blocks for event in block.events]
    said = [record.getMessage() for record in caplog.records] + [str(vars(record)["peer"]) for record in caplog.records]
    assert len(texts) >= 100
    assert all(text.isprintable() and len(text) < 1000 for text in (*texts, *said))
    assert steady(summary) == steady(honest)


@given(st.text() | st.from_regex(rf"{keys.ROOT}/{RUN}/(node|alive)/.*/.*"))
def test_any_key_is_that_of_a_node_or_is_dropped(key: str) -> None:
    for read in (keys.node_of, keys.presence_of):
        try:
            found: Any = "".join(read(key))
        except MessageRejected as error:
            found = error
        if isinstance(found, MessageRejected):
            assert (found.reason, str(found).isprintable()) == ("wrong-key", True)
        else:
            assert found.isascii()
            assert found.isprintable()
            assert not set(found) & set("*/$ ")
