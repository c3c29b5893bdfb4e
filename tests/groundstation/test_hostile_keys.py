"""The world drops keys that no node uses, and never shows them as they came."""

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
from meanflock.swarm.wire.messages import Join
from tests.golden.flights import steady
from tests.groundstation.flights import RUN, fly, scenario

SUFFIXES = (
    *("", "/**", "/node", "/node//act", "/node/*/act", "/node/$*/act", "/node/agent-1/**", "/node/agent-1/act\n"),
    *("/node/agent-1\x1b[2J/act", "/node/agent-1\nlost agent-2/act", "/node/\u202eagent-1/act"),
    *("/alive", "/alive/agent/\x1b]0;x\x07", "/alive/**"),
)
HOSTILE_KEYS = ["", "/", "**", "*", "x", f"{keys.ROOT}/**", "a/" * 20_000]
HOSTILE_KEYS += [f"{keys.ROOT}/{RUN}{suffix}" for suffix in SUFFIXES]


def test_a_hostile_key_is_dropped_escaped_and_changes_nothing(caplog: pytest.LogCaptureFixture) -> None:
    flown = scenario("mfg", "duration=2")
    honest, kept = fly(flown), Kept()
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
