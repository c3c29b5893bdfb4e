"""Floods, refusals and absurd numbers of a flight. Bytes that make no sense: tests/faults/test_hostile_input.py."""

from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Event, FrameKind, Frames, Join, Refusal
from meanflock.swarm.wire.tick import TYPES, read_sense, write_act
from tests.groundstation.flights import INT8, NUMBER, RUN, fly, scenario, steady


def act(tick: int, rows: int = 2, **changes: Any) -> Act:
    fields: dict[str, Any] = {"run": NUMBER, "tick": tick, "commands": np.full((rows, 5), 3.0), **changes}
    return Act(**fields)


def batch(**changes: Any) -> Frames:
    fields: dict[str, Any] = {
        "kind": FrameKind.UPLOAD,
        "round": 1,
        "source": np.array([0, 1], dtype=np.int32),
        "payload": np.zeros((2, 246), dtype=np.float32),
        **changes,
    }
    return Frames(**fields)


def test_hostile_bytes_in_place_of_a_model_are_dropped_and_change_nothing() -> None:
    flown = scenario("mfgfl-hf", "duration=6", *INT8)
    honest = fly(flown, uavs_per_node=2)
    engine = Engine(flown, RUN, uavs_per_node=2)
    good = np.zeros((2, 262), dtype="u1")
    good[:, 246:] = np.ones((2, 4), dtype="<f4").view("u1")
    beyond, no_scale = good.copy(), good.copy()
    beyond[1, 17] = 0x80
    no_scale[0, 246:250] = 0
    payloads = [(good[:, :-1], "wrong-shape"), (good.astype("<f4"), "wrong-shape"), (beyond, "non-finite")]
    payloads += [(no_scale, "non-finite"), (np.zeros((2, 246), dtype="<f4"), "wrong-shape")]
    for tick in engine.fly():
        asked = tick - 1
        acts = [(act(asked, outbox=(batch(payload=sent),)), reason) for sent, reason in payloads]
        acts.append((act(asked, outbox=(batch(payload=good),)), "duplicate"))  # else well
        for message, reason in acts if tick % 7 == 0 else ():
            before = engine.world.counters.drops.copy()
            engine.world.handle(Delivery("message", keys.act(RUN, "agent-0"), write_act(message)))
            assert engine.world.counters.drops - before == {reason: 1}
    assert steady(engine.world.finish()) == steady(honest)


def test_a_flood_is_counted_but_does_not_flood_the_log_of_events() -> None:
    kept = Kept()
    engine = Engine(scenario("mfg", "duration=3"), RUN, sinks=[kept])
    for _ in engine.fly():
        for _ in range(20):
            engine.world.handle(Delivery("message", keys.act(RUN, "agent-7"), b"\xc1"))
    assert engine.world.finish()["dropped_messages"] == {"unknown-node": 600}
    events = [event.kind for block in kept.blocks for event in block.events]
    assert events.count("dropped") == 100


def test_a_node_that_tells_events_without_end_floods_the_log_no_more_than_what_is_dropped() -> None:
    kept = Kept()
    engine = Engine(scenario("mfg", "duration=3"), RUN, sinks=[kept], uavs_per_node=2)
    for tick in engine.fly():
        for _ in range(20):
            said = control.encode(Event(tick, "failed", "again"))
            engine.world.handle(Delivery("message", keys.act(RUN, "agent-0"), said))
    assert engine.world.finish()["dropped_messages"] == {"oversized": 600 - 102}  # 100, and one for each of its UAVs
    events = [event.kind for block in kept.blocks for event in block.events]
    assert (events.count("agent"), events.count("dropped")) == (102, 100)


@pytest.mark.parametrize(
    "join",
    [
        Join("agent", 1),
        Join("agent", 1, 2),
        Join("agent", 2**63, 2**63),
        Join("agent", 0),
        Join("agent", -5),
        Join("leader", 0),
        Join("pirate", 1),
    ],
)
def test_who_comes_late_or_is_nobody_is_refused_in_words(join: Join) -> None:
    engine, replies = Engine(scenario("mfg", "duration=2"), RUN), []
    key = keys.join(RUN, keys.asker(join.role, join.uav))
    engine.world.handle(Delivery("question", key, control.encode(join), replies.append))
    (answer,) = (control.decode(raw) for raw in replies)
    assert isinstance(answer, Refusal)
    assert answer.reason
    assert answer.for_now == ("its agent already" in answer.reason)  # it may be lost; the rest will not change


def test_who_asks_under_the_name_of_another_is_dropped_without_an_answer() -> None:
    engine, replies = Engine(scenario("mfg", "duration=2"), RUN), []
    for name, join in (("agent-1", Join("agent", 1, 2)), ("agent", Join("leader", 0)), ("x", Join("agent", 1))):
        engine.world.handle(Delivery("question", keys.join(RUN, name), control.encode(join), replies.append))
    assert not replies
    assert engine.world.counters.drops == {"wrong-name": 3}


# -- finite, well-formed and absurd -------------------------------------------------------------------------------


class Forger:
    """Answers for agent-0, which holds UAVs 0 and 1, in one tick."""

    def __init__(self, engine: Engine, tick: int, **changes: Any) -> None:
        self._world, self._tick, self._changes = engine.world, tick, changes
        self._put = engine.world._bus.put
        engine.world._bus.put = self.put  # type: ignore[method-assign]

    def put(self, key: str, payload: bytes) -> None:
        asked = key == keys.sense(RUN, "agent-0") and payload[1:2] in TYPES
        if asked and read_sense(payload).tick == self._tick:
            forged = write_act(act(self._tick, **self._changes))
            self._world.handle(Delivery("message", keys.act(RUN, "agent-0"), forged))
            return
        self._put(key, payload)


ABSURD: dict[str, dict[str, Any]] = {
    "acceleration": {"commands": np.array([[1e300, 0, 0, 0, 0], [0, 0, 0, 0, 0]])},
    "residual": {"commands": np.array([[0, 0, 1e300, 0, 0], [0, 0, 0, 0, 0]])},
    "interaction": {"commands": np.array([[0, 0, 0, 0, 1e39], [0, 0, 0, 0, 0]])},
    "report": {"commands": np.zeros((2, 5)), "models": np.full((2, 246), 1e300)},
    "report beyond a float": {"commands": np.zeros((2, 5)), "models": np.full((2, 246), 1e39)},
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("what", ABSURD)
def test_an_absurd_number_from_one_node_costs_neither_the_others_nor_the_recording(what: str) -> None:
    kept = Kept()
    engine = Engine(scenario("mfg", "duration=6"), RUN, uavs_per_node=2, sinks=[kept])
    Forger(engine, 10, **ABSURD[what])  # a tick in which reports are asked for
    for _ in engine.fly():
        pass
    summary = engine.world.finish(lambda: 0.5)
    assert summary["ticks"] == 60
    assert summary["lost"] <= 2
    assert np.isfinite(engine.world.flight.states).all()
    assert engine.station is not None
    assert engine.station.summary is not None
    assert sum(len(block.states) for block in kept.blocks) == 61
