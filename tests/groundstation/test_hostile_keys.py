"""Keys of the network that nobody of ours would use are dropped, and never shown as they came."""

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
from tests.groundstation.flights import RUN, fly, scenario, steady

HOSTILE_KEYS = [
    "",
    "/",
    "**",
    "*",
    "x",
    f"{keys.ROOT}/**",
    f"{keys.ROOT}/{RUN}/**",
    f"{keys.ROOT}/{RUN}/node",
    f"{keys.ROOT}/{RUN}/node//act",
    f"{keys.ROOT}/{RUN}/node/*/act",
    f"{keys.ROOT}/{RUN}/node/$*/act",
    f"{keys.ROOT}/{RUN}/node/agent-1/**",
    f"{keys.ROOT}/{RUN}/node/agent-1/act\n",
    f"{keys.ROOT}/{RUN}/node/agent-1\x1b[2J/act",
    f"{keys.ROOT}/{RUN}/node/agent-1\nlost agent-2/act",
    f"{keys.ROOT}/{RUN}/node/\u202eagent-1/act",
    f"{keys.ROOT}/{RUN}/alive",
    f"{keys.ROOT}/{RUN}/alive/agent/\x1b]0;x\x07",
    f"{keys.ROOT}/{RUN}/alive/**",
    "a/" * 20_000,
]


def test_no_key_raises_or_is_shown_as_it_came(caplog: pytest.LogCaptureFixture) -> None:
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
                Delivery("oversized", key, size=1),  # longer than any message that may come under such a key
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
def test_whatever_the_key_the_world_reads_it_as_a_nodes_or_drops_it(key: str) -> None:
    for read in (keys.node_of, keys.presence_of):
        found: Any
        try:
            found = read(key)
        except MessageRejected as error:
            found = error
        if isinstance(found, MessageRejected):
            assert found.reason == "wrong-key"
            assert str(found).isprintable()
        else:
            assert "".join(found).isascii()
            assert "".join(found).isprintable()
            assert not set("".join(found)) & set("*/$ ")
