"""Contract of hostile input: receiver × mutation → the reason of the drop, and the flight is as if nothing had come.

Here anybody sends bytes between two ticks, also floods, joins and keys that no node uses. Replies of a genuine node in
its turn: test_false_replies.py. Readers of bytes: tests/swarm/test_hostile_bytes.py.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.federation.plan import plan_of
from meanflock.launch.station import StoredTelemetry
from meanflock.net import keys
from meanflock.net.bus import Delivery
from meanflock.swarm.declared import MAX_BROADCASTS
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.events import AgentFailed, AverageFailed, FitFailed, FlightEvent
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import (
    FAILED,
    UNAVERAGED,
    UNTRAINED,
    Acknowledgement,
    Act,
    Event,
    FrameKind,
    Frames,
    Join,
    Ready,
    Refusal,
    Sense,
    Stop,
)
from tests.faults.clusters import FLOATS, swarm
from tests.faults.conftest import RUN, Lab, honest, scenario
from tests.golden.flights import steady
from tests.memory_swarm import MemorySwarm
from tests.swarm.examples import written

NUMBER = keys.fingerprint(RUN)
MODELS, STATES, HEADS = scenario(), scenario(method="hjb"), swarm()
BYTES = scenario("federation.payload=int8", "federation.broadcast_payload=int8", method="mfgfl-hf")
WIDEST = plan_of(STATES).declared.broadcast_numbers
Changes = list[tuple[str, dict[str, Any], str]]  # name, changed fields of an Act, and the reason of its drop
replace = msgspec.structs.replace


def uavs(*numbers: int) -> np.ndarray:
    return np.array(numbers, dtype=np.int32)


def batch(
    kind: FrameKind, *source: int, width: int, number: int = 1, dtype: str = "<f4", links: np.ndarray | None = None
) -> Frames:
    return Frames(kind, number, uavs(*source), np.zeros((len(source), width), dtype), links)


upload, relayed = partial(batch, FrameKind.UPLOAD, width=FLOATS), partial(batch, FrameKind.RELAY)
state = partial(batch, FrameKind.STATE, width=4, number=0)
LINKS = np.zeros((1, 2), np.int32)


def sent(*batches: Frames) -> dict[str, Any]:
    return {"outbox": batches}


def relay(head: int = 4, count: float = 4.0, width: int = FLOATS + 1, **options: Any) -> dict[str, Any]:
    frames = relayed(head, width=width, **options)
    frames.payload[:, -1] = count
    return sent(frames)


def in_bytes(weight: int = 0, scale: float = 1.0) -> dict[str, Any]:
    frames = upload(0, width=262, dtype="u1")
    frames.payload[0, 17] = weight
    frames.payload[0, 246:] = np.full(4, scale, "<f4").view("u1")
    return sent(frames)


# Acts of agent-0, which has UAV 0 alone of six that upload models.
UPLOADS: Changes = [
    ("models too short", {"models": np.zeros((1, 245))}, "wrong-shape"),
    ("models that are infinite", {"models": np.full((1, 246), np.inf)}, "non-finite"),
    ("a loss of another node's UAV", {"lost": uavs(2)}, "wrong-shape"),
    ("a loss of a UAV that is not there", {"lost": uavs(2**31 - 1)}, "wrong-shape"),
    ("a refused upload", {"refused_uploads": uavs(3)}, "wrong-shape"),
    ("a wait of a UAV that does not average", {"waiting": uavs(0)}, "wrong-shape"),
    ("its own state refused", {"refused_states": uavs(0)}, "wrong-shape"),
    ("a state refused twice", {"refused_states": uavs(3, 3)}, "wrong-shape"),
    ("a refused state of no UAV", {"refused_states": uavs(6)}, "wrong-shape"),
    ("a refused state of a negative UAV", {"refused_states": uavs(-1)}, "wrong-shape"),
    ("two batches of one kind", sent(upload(0), upload(0)), "wrong-shape"),
    ("a global model", sent(batch(FrameKind.GLOBAL, 0, width=FLOATS)), "wrong-kind"),
    ("an upload too short", sent(upload(0, width=FLOATS - 1)), "wrong-shape"),
    ("an upload in doubles", sent(upload(0, dtype="<f8")), "wrong-shape"),
    ("an upload in bytes", sent(upload(0, dtype="i1")), "wrong-shape"),
    ("an upload of another UAV", sent(upload(2)), "wrong-shape"),
    ("an upload of a negative UAV", sent(upload(-1)), "wrong-shape"),
    ("an upload of no UAV", sent(upload()), "wrong-shape"),
    ("two uploads of one UAV", sent(upload(0, 0)), "wrong-shape"),
    ("an upload with links", sent(upload(0, links=LINKS)), "wrong-shape"),
]
# Acts of agent-0, which has the UAVs 0, 1 and 2 of six that broadcast states.
BROADCASTS: Changes = [
    ("a state of another node", sent(state(4)), "wrong-shape"),
    ("a state of no UAV", sent(state(6)), "wrong-shape"),
    ("two states of one UAV", sent(state(1, 1)), "wrong-shape"),
    ("states in descending order", sent(state(2, 0)), "wrong-shape"),
    ("an empty batch", sent(state()), "wrong-shape"),
    ("a broadcast of no numbers", sent(state(1, width=0)), "wrong-shape"),
    ("a broadcast of too many numbers", sent(state(1, width=WIDEST + 1)), "wrong-shape"),
    ("too many broadcasts", sent(state(1, number=MAX_BROADCASTS)), "wrong-shape"),
    ("one broadcast in two batches", sent(state(0), state(2)), "wrong-shape"),
    ("wider floats than the radio's", sent(state(1, dtype="<f8")), "wrong-shape"),
    ("narrower floats than the radio's", sent(state(1, dtype="<f2")), "wrong-shape"),
    ("a state with links", sent(state(1, number=1, links=LINKS)), "wrong-shape"),
    ("an upload without rounds", sent(upload(1)), "wrong-kind"),
    ("a relay", sent(relayed(1, width=FLOATS)), "wrong-kind"),
]
# Acts of agent-4, a head of four UAVs that has just relayed their mean.
OF_HEADS: Changes = [
    ("a relay of more models than its cluster has", relay(count=5.0), "wrong-shape"),
    ("a relay of two models and a half", relay(count=2.5), "wrong-shape"),
    ("a relay of no model", relay(count=0.0), "wrong-shape"),
    ("a relay without a count", relay(width=FLOATS), "wrong-shape"),
    ("a relay in doubles", relay(dtype="<f8"), "wrong-shape"),
    ("a relay of another head", relay(8), "wrong-shape"),
    ("a relay of a UAV that is no head", relay(5), "wrong-shape"),
    ("a relay with links", relay(links=LINKS), "wrong-shape"),
    *(
        (f"{field} of {who}", {field: uavs(*who)}, "wrong-shape")
        for field, whose in (
            ("refused_uploads", ((0,), (5, 5), (12,), (-1,))),
            ("refused_states", ((5, 5), (12,), (-1,))),
            ("waiting", ((0,), (5,), (4, 8), (12,), (-1,))),
        )
        for who in whose
    ),
]
# Acts of agent-0, which has UAV 0 alone of six that upload bytes, with a scale of four bytes for each of four blocks.
OF_BYTES: Changes = [
    ("an upload too short", sent(upload(0, width=261, dtype="u1")), "wrong-shape"),
    ("floats for bytes", sent(upload(0, width=262)), "wrong-shape"),
    ("a byte that is no weight", in_bytes(weight=0x80), "non-finite"),
    ("a scale of zero", in_bytes(scale=0.0), "non-finite"),
]
OF_LEADERS: Changes = [
    ("a broadcast of states", sent(state(0)), "wrong-kind"),
    ("a refused state", {"refused_states": uavs(3)}, "wrong-shape"),
    ("a wait", {"waiting": uavs(0)}, "wrong-shape"),
]


class Receiver(NamedTuple):
    """A message that it accepts, where its bytes are handed over, its counts of drops, and Acts that it rejects."""

    valid: Any
    deliver: Callable[[bytes], object]
    dropped: Callable[[], dict[str, int]]
    changes: Changes


def at_world(lab: Lab, key: str, valid: Any, changes: Changes) -> Receiver:
    kind: Any = "question" if isinstance(valid, Join) else "message"

    def deliver(raw: bytes) -> None:
        lab.engine.nodes.handle(Delivery(kind, key, raw, pytest.fail))

    return Receiver(valid, deliver, lambda: lab.world.counters.drops, changes)


def at_node(lab: Lab, tick: int, name: str, rows: int) -> Receiver:
    client = lab.client_of(name)

    def deliver(raw: bytes) -> None:
        client.handle(Delivery("message", keys.sense(RUN, name), raw))

    return Receiver(Sense(NUMBER, tick + 1, np.zeros((rows, 4))), deliver, lambda: client.dropped, [])


def at_station(lab: Lab) -> Receiver:
    station, latest = lab.engine.station, lab.record.blocks[-1]

    def deliver(raw: bytes) -> None:
        station.handle(Delivery("message", keys.telemetry(RUN), raw))

    return Receiver(replace(latest, block=latest.block + 1), deliver, lambda: station.dropped, [])


def act(tick: int, rows: int, columns: int = 5) -> Act:
    return Act(NUMBER, tick, np.zeros((rows, columns)))


AGENT, HEAD, LEADER = (keys.act(RUN, name) for name in ("agent-0", "agent-4", "leader"))
JOIN, RECEIPT = keys.join(RUN, "agent-0"), keys.received(RUN)
WIDTH = 2 + len(plan_of(STATES).declared.diagnostics)
# A flight, the UAVs of each of its nodes, and how to make the receiver after a tick.
RECEIVERS: dict[str, tuple[Scenario, int, Callable[[Lab, int], Receiver]]] = {
    "world: reply": (MODELS, 1, lambda lab, tick: at_world(lab, AGENT, act(tick, 1), UPLOADS)),
    "world: reply with states": (STATES, 3, lambda lab, tick: at_world(lab, AGENT, act(tick, 3, WIDTH), BROADCASTS)),
    "world: reply in bytes": (BYTES, 1, lambda lab, tick: at_world(lab, AGENT, act(tick, 1), OF_BYTES)),
    "world: reply of a head": (HEADS, 1, lambda lab, tick: at_world(lab, HEAD, act(tick, 1), OF_HEADS)),
    "world: leader's reply": (MODELS, 1, lambda lab, tick: at_world(lab, LEADER, act(tick, 0), OF_LEADERS)),
    "world: join": (MODELS, 1, lambda lab, _: at_world(lab, JOIN, Join("agent", 1, 0), [])),
    "world: receipt": (MODELS, 1, lambda lab, _: at_world(lab, RECEIPT, Acknowledgement(NUMBER, 1), [])),
    "agent": (MODELS, 1, lambda lab, tick: at_node(lab, tick, "agent-0", 1)),
    "leader": (MODELS, 1, lambda lab, tick: at_node(lab, tick, "leader", 0)),
    "station": (MODELS, 1, lambda lab, _: at_station(lab)),
}
TABLES = {"Act": "commands", "Sense": "states", "Telemetry": "states"}  # of numbers


def mutations(receiver: Receiver) -> Iterator[tuple[str, bytes, str]]:
    """Name, bytes and expected reason of every mutation that fits the receiver's message."""
    valid, raw, kind = receiver.valid, written(receiver.valid), type(receiver.valid).__name__
    yield "nothing", b"", "malformed"
    yield "noise", b"\xc1" * 20, "malformed"
    yield "cut off", raw[:-1], "malformed"
    yield "with a tail", raw + b"\0", "malformed"
    yield "twice in one", raw + raw, "malformed"
    yield "endless", bytes(100_000), "malformed" if kind in ("Sense", "Telemetry") else "oversized"
    other = Stop(NUMBER, "x") if not isinstance(valid, Sense) else Ready(NUMBER)
    yield "of another kind", written(other), "wrong-kind"
    if hasattr(valid, "run"):
        reason = "wrong-kind" if kind == "Telemetry" else "wrong-run"
        yield "of another run", written(replace(valid, run=NUMBER ^ 1)), reason
    if hasattr(valid, "tick"):
        yield "of the past", written(replace(valid, tick=valid.tick - 2)), "stale"
    if isinstance(valid, Act):
        yield "of the future", written(replace(valid, tick=2**32 - 1)), "stale"
        yield "unexpected", raw, "duplicate"
        yield "with an endless memory", written(replace(valid, memory=bytes(100_000))), "oversized"
    for mutation, changes, reason in receiver.changes:
        yield mutation, written(replace(valid, **changes)), reason
    name = TABLES.get(kind, "")
    if name and len(table := getattr(valid, name)):
        for bad in (np.nan, -np.inf):
            numbers = table.copy()
            numbers[..., -1] = bad
            yield f"with {bad}", written(replace(valid, **{name: numbers})), "non-finite"
        for numbers in (np.concatenate([table, table]), table[..., :-1]):
            yield f"with a table {numbers.shape}", written(replace(valid, **{name: numbers})), "wrong-shape"


@pytest.mark.parametrize("name", RECEIVERS)
def test_a_receiver_drops_each_mutation_for_its_reason_and_the_flight_is_the_same(name: str) -> None:
    flown, rows, make = RECEIVERS[name]
    lab, thrown = Lab(flown, uavs_per_node=rows), 0
    for tick in lab.engine.fly():
        if tick not in (22, 42, 62):  # the leader was asked in the tick before
            continue
        receiver = make(lab, tick - 1)
        for mutation, raw, reason in mutations(receiver):
            before = dict(receiver.dropped())
            receiver.deliver(raw)
            after = receiver.dropped()
            found = {drop: count - before.get(drop, 0) for drop, count in after.items() if count != before.get(drop, 0)}
            assert found == {reason: 1}, mutation
            thrown += 1
    summary = lab.engine.finish()
    assert thrown >= 3 * 7
    assert summary["trajectory_sha256"] == honest(flown)
    nothing = ("lost", "nodes_lost", "telemetry_blocks_dropped", "uploads_refused", "states_refused")
    assert not any(summary[name] for name in nothing)
    assert sum(summary["dropped_messages"].values()) == (thrown if name.startswith("world") else 0)


@pytest.mark.parametrize(
    ("node", "dropped", "kind", "logged"),
    [
        ("agent-7", {"unknown-node": 600}, "dropped", 100),
        ("agent-0", {"oversized": 600 - 102}, "agent", 102),  # 100 events, and one for each of its UAVs
    ],
)
def test_a_flood_is_counted_and_logged_up_to_a_limit(node, dropped, kind, logged) -> None:
    kept = StoredTelemetry()
    engine = MemorySwarm(scenario("duration=3", method="mfg"), RUN, sinks=[kept], uavs_per_node=2)
    for tick in engine.fly():
        message = b"\xc1" if kind == "dropped" else control.encode(Event(tick, "failed", "again"))
        for _ in range(20):
            engine.nodes.handle(Delivery("message", keys.act(RUN, node), message))
    assert engine.finish()["dropped_messages"] == dropped
    events = [event.kind for block in kept.blocks for event in block.events]
    assert (events.count(kind), events.count("dropped")) == (logged, 100)


def reported(report: str, uavs: tuple[int, ...]) -> tuple[list[FlightEvent], dict[str, int]]:
    """The events of failures of a flight whose agent-0 with UAV 0 reports one, and the messages that were dropped."""
    kept = StoredTelemetry()
    engine = MemorySwarm(scenario("duration=1", method="mfg"), RUN, sinks=[kept], uavs_per_node=1)
    ticks = engine.fly()
    tick = next(ticks)
    message = control.encode(Event(tick, report, "no data", uavs))
    engine.nodes.handle(Delivery("message", keys.act(RUN, "agent-0"), message))
    for _ in ticks:
        pass
    dropped = engine.finish()["dropped_messages"]
    failures = FitFailed | AverageFailed | AgentFailed
    events = [event for block in kept.blocks for event in block.events if isinstance(event, failures)]
    return events, dropped


@pytest.mark.parametrize("report", [UNTRAINED, UNAVERAGED])
@pytest.mark.parametrize(("uavs", "dropped"), [((0,), 0), ((1,), 1), ((), 1), ((0, 0), 1), ((0, 1), 1)])
def test_a_node_may_report_what_failed_at_its_own_uavs_only(report: str, uavs: tuple[int, ...], dropped: int) -> None:
    events, dropped_messages = reported(report, uavs)
    assert dropped_messages == ({"wrong-shape": 1} if dropped else {})
    assert [(event.uavs, event.failure) for event in events] == ([] if dropped else [((0,), "no data")])


@pytest.mark.parametrize(
    ("uavs", "told"),
    [((0,), ["controller 'mfg' failed with UAV 0: no data"]), ((), ["no data"]), ((1,), []), ((0, 0), []), ((9,), [])],
)
def test_a_node_may_report_that_the_controller_failed_with_its_own_uavs_only(
    uavs: tuple[int, ...], told: list[str]
) -> None:
    events, dropped_messages = reported(FAILED, uavs)
    assert dropped_messages == ({} if told else {"wrong-shape": 1})
    assert [event.failure for event in events] == told


JOINS = [Join("agent", 1), Join("agent", 1, 2), Join("agent", 2**63, 2**63), Join("agent", 0), Join("agent", -5)]


@pytest.mark.parametrize("join", [*JOINS, Join("leader", 0), Join("pirate", 1)])
def test_a_join_without_a_free_place_is_refused_with_a_reason(join: Join) -> None:
    engine, replies = MemorySwarm(scenario("duration=2", method="mfg"), RUN), []
    key = keys.join(RUN, keys.requested_name(join.role, join.uav))
    engine.nodes.handle(Delivery("question", key, control.encode(join), replies.append))
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
    honest, kept = MemorySwarm(flown, RUN).complete(), StoredTelemetry()
    engine, replies = MemorySwarm(flown, RUN, sinks=[kept]), []
    question = control.encode(Join("agent", 1))
    for tick in engine.fly():
        if tick != 4:
            continue
        for key in (keys.act(RUN, "agent-0"), keys.received(RUN)):
            engine.nodes.handle(Delivery("oversized", key, size=70, largest=64))
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
                engine.nodes.handle(delivery)
                assert engine.world.counters.drops.total() == before + 1, delivery
    summary = engine.finish()
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
