"""Floods, refused joins and false models. Malformed messages: tests/faults/test_hostile_input.py."""

from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Event, FrameKind, Frames, Join, Refusal
from meanflock.swarm.wire.tick import write_act
from tests.golden.flights import steady
from tests.groundstation.flights import INT8, NUMBER, RUN, fly, scenario


def act(tick: int, rows: int = 2, **changes: Any) -> Act:
    fields: dict[str, Any] = {"run": NUMBER, "tick": tick, "commands": np.full((rows, 5), 3.0), **changes}
    return Act(**fields)


def test_hostile_bytes_in_place_of_a_model_are_dropped_and_change_nothing() -> None:
    flown = scenario("mfgfl-hf", "duration=6", *INT8)
    engine = Engine(flown, RUN, uavs_per_node=2)
    good = np.zeros((2, 262), dtype="u1")
    good[:, 246:] = np.ones((2, 4), dtype="<f4").view("u1")
    beyond, no_scale = good.copy(), good.copy()
    beyond[1, 17] = 0x80
    no_scale[0, 246:250] = 0
    payloads = [(good[:, :-1], "wrong-shape"), (good.astype("<f4"), "wrong-shape"), (beyond, "non-finite")]
    payloads += [(no_scale, "non-finite"), (good, "duplicate")]  # the last one is well formed
    for tick in engine.fly():
        for payload, reason in payloads if tick % 7 == 0 else ():
            frames = Frames(FrameKind.UPLOAD, 1, np.array([0, 1], dtype=np.int32), payload)
            before = engine.world.counters.drops.copy()
            message = write_act(act(tick - 1, outbox=(frames,)))
            engine.world.handle(Delivery("message", keys.act(RUN, "agent-0"), message))
            assert engine.world.counters.drops - before == {reason: 1}
    assert steady(engine.world.finish()) == steady(fly(flown, uavs_per_node=2))


@pytest.mark.parametrize(
    ("node", "dropped", "kind", "logged"),
    [
        ("agent-7", {"unknown-node": 600}, "dropped", 100),
        ("agent-0", {"oversized": 600 - 102}, "agent", 102),  # 100 events, and one for each of its UAVs
    ],
)
def test_a_flood_is_counted_and_logged_up_to_a_limit(
    node: str, dropped: dict[str, int], kind: str, logged: int
) -> None:
    kept = Kept()
    engine = Engine(scenario("mfg", "duration=3"), RUN, sinks=[kept], uavs_per_node=2)
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
    engine, replies = Engine(scenario("mfg", "duration=2"), RUN), []
    key = keys.join(RUN, keys.asker(join.role, join.uav))
    engine.world.handle(Delivery("question", key, control.encode(join), replies.append))
    (answer,) = (control.decode(raw) for raw in replies)
    assert isinstance(answer, Refusal)
    assert answer.reason
    assert answer.for_now == ("its agent already" in answer.reason)  # that agent may be lost later


def test_a_join_under_the_name_of_another_node_is_dropped_without_an_answer() -> None:
    engine, replies = Engine(scenario("mfg", "duration=2"), RUN), []
    for name, join in (("agent-1", Join("agent", 1, 2)), ("agent", Join("leader", 0)), ("x", Join("agent", 1))):
        engine.world.handle(Delivery("question", keys.join(RUN, name), control.encode(join), replies.append))
    assert not replies
    assert engine.world.counters.drops == {"wrong-name": 3}
