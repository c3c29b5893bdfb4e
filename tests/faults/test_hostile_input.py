"""Contract of hostile input: receiver × mutation → the reason of the drop, and the flight is as if nothing had come.

The documented limits of it stand at the end. Readers of bytes: tests/swarm/test_hostile_bytes.py.
"""

import itertools
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

from meanflock.federation.schedule import Schedule
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Delivery
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Join, Ready, Received, Sense, Stop
from tests.faults.clusters import CLEAR, FLOATS, PERIOD, globals_of, swarm
from tests.faults.conftest import RUN, Lab, scenario
from tests.swarm.examples import read, written

NUMBER = keys.fingerprint(RUN)
replace = msgspec.structs.replace


@cache
def honest(encoded: bytes) -> str:
    """The trajectory of a scenario in which nobody lies."""
    return str(Lab(scenarios.decode(encoded), uavs_per_node=1).fly()["trajectory_sha256"])


# -- bytes that anybody may send, between two ticks ------------------------------------------------------------------


class Receiver(NamedTuple):
    """A receiver of one kind of message, in a flight after a tick.

    valid: a message that it would take. table: name of its table of numbers. deliver: hands it bytes.
    dropped: its counts of drops, by reason. oversized, other_run: the reasons it has for these.
    """

    valid: Any
    table: str
    deliver: Callable[[bytes], object]
    dropped: Callable[[], dict[str, int]]
    oversized: str = "malformed"
    other_run: str = "wrong-run"


def receivers(lab: Lab, tick: int) -> dict[str, Receiver]:
    """All receivers of messages after a tick of a flight with an agent for each UAV."""

    def node(name: str, rows: int) -> Receiver:
        client, key = lab.client_of(name), keys.sense(RUN, name)
        valid = Sense(NUMBER, tick + 1, np.zeros((rows, 4)))

        def deliver(raw: bytes) -> None:
            client.handle(Delivery("message", key, raw))

        return Receiver(valid, "states" if rows else "", deliver, lambda: client.dropped)

    def world(valid: Any, table: str, kind: Any, key: str) -> Receiver:
        def deliver(raw: bytes) -> None:
            lab.world.handle(Delivery(kind, key, raw, pytest.fail))

        return Receiver(valid, table, deliver, lambda: lab.world.counters.drops, "oversized")

    station = lab.engine.station
    assert station is not None
    key = keys.telemetry(RUN)
    return {
        "world: reply": world(Act(NUMBER, tick, np.zeros((1, 5))), "commands", "message", keys.act(RUN, "agent-0")),
        "world: leader's reply": world(Act(NUMBER, tick, np.zeros((0, 5))), "", "message", keys.act(RUN, "leader")),
        "world: join": world(Join("agent", 1, 0), "", "question", keys.join(RUN, "agent-0")),
        "world: receipt": world(Received(NUMBER, 1), "", "message", keys.received(RUN)),
        "agent": node("agent-0", 1),
        "leader": node("leader", 0),
        "station": Receiver(
            replace(lab.record.blocks[-1], block=lab.record.blocks[-1].block + 1),
            "states",
            lambda raw: station.handle(Delivery("message", key, raw)),
            lambda: station.dropped,
            other_run="wrong-kind",
        ),
    }


def uavs(*numbers: int) -> np.ndarray:
    return np.array(numbers, dtype=np.int32)


def outbox(count: int = 1, **changes: Any) -> dict[str, Any]:
    """So many equal batches: an upload of UAV 0, or another."""
    fields = {"kind": FrameKind.UPLOAD, "round": 1, "source": uavs(0), "payload": np.zeros((1, FLOATS), "<f4")}
    return {"outbox": (Frames(**{**fields, **changes}),) * count}


# An Act of agent-0, which has UAV 0 alone of six: what is changed in it, and the reason of the drop.
ACTS: list[tuple[str, dict[str, Any], str]] = [
    ("models too short", {"models": np.zeros((1, 245))}, "wrong-shape"),
    ("models that are infinite", {"models": np.full((1, 246), np.inf)}, "non-finite"),
    ("a loss of another node's UAV", {"lost": uavs(2)}, "wrong-shape"),
    ("a loss of a UAV that is not there", {"lost": uavs(2**31 - 1)}, "wrong-shape"),
    ("a refused upload", {"refused": uavs(~3)}, "wrong-shape"),
    ("its own state refused", {"refused": uavs(0)}, "wrong-shape"),
    ("a state refused twice", {"refused": uavs(3, 3)}, "wrong-shape"),
    ("a refused state of no UAV", {"refused": uavs(6)}, "wrong-shape"),
    ("two batches of one kind", outbox(2), "wrong-shape"),
    ("a global model", outbox(kind=FrameKind.GLOBAL), "wrong-kind"),
    ("an upload too short", outbox(payload=np.zeros((1, FLOATS - 1), "<f4")), "wrong-shape"),
    ("an upload in doubles", outbox(payload=np.zeros((1, FLOATS))), "wrong-shape"),
    ("an upload in bytes", outbox(payload=np.zeros((1, FLOATS), "i1")), "wrong-shape"),
    ("an upload of another UAV", outbox(source=uavs(2)), "wrong-shape"),
    ("an upload of a negative UAV", outbox(source=uavs(-1)), "wrong-shape"),
    ("an upload of no UAV", outbox(source=uavs(), payload=np.zeros((0, FLOATS), "<f4")), "wrong-shape"),
    ("two uploads of one UAV", outbox(source=uavs(0, 0), payload=np.zeros((2, FLOATS), "<f4")), "wrong-shape"),
    ("an upload with links", outbox(links=np.zeros((1, 2), np.int32)), "wrong-shape"),
]


def mutations(receiver: Receiver) -> Iterator[tuple[str, bytes, str]]:
    """Name, bytes and expected reason of everything that fits the receiver's message."""
    valid, raw = receiver.valid, written(receiver.valid)
    yield "nothing", b"", "malformed"
    yield "noise", b"\xc1" * 20, "malformed"
    yield "cut off", raw[:-1], "malformed"
    yield "with a tail", raw + b"\0", "malformed"
    yield "twice in one", raw + raw, "malformed"
    yield "endless", bytes(100_000), receiver.oversized
    other = Stop(NUMBER, "x") if not isinstance(valid, Sense) else Ready(NUMBER)
    yield "of another kind", written(other), "wrong-kind"
    if hasattr(valid, "run"):
        yield "of another run", written(replace(valid, run=NUMBER ^ 1)), receiver.other_run
    if hasattr(valid, "tick"):
        yield "of the past", written(replace(valid, tick=valid.tick - 2)), "stale"
    if isinstance(valid, Act):
        yield "of the future", written(replace(valid, tick=2**32 - 1)), "stale"
        yield "unexpected", raw, "duplicate"
        yield "with an endless memory", written(replace(valid, memory=bytes(100_000))), "oversized"
        for what, changes, reason in ACTS if receiver.table else ():
            yield what, written(replace(valid, **changes)), reason
    if receiver.table:
        table = getattr(valid, receiver.table)
        for name, bad in {"a NaN": np.nan, "an infinity": -np.inf}.items():
            numbers = table.copy()
            numbers[..., -1] = bad
            yield f"with {name}", written(replace(valid, **{receiver.table: numbers})), "non-finite"
        rows = np.concatenate([table, table])
        yield "with more rows", written(replace(valid, **{receiver.table: rows})), "wrong-shape"
        narrow = table[..., :-1]
        yield "with fewer columns", written(replace(valid, **{receiver.table: narrow})), "wrong-shape"


NAMES = ("world: reply", "world: leader's reply", "world: join", "world: receipt", "agent", "leader", "station")


@pytest.mark.parametrize("name", NAMES)
def test_a_receiver_drops_each_mutation_for_its_reason_and_the_flight_is_the_same(name: str) -> None:
    flown = scenario()
    lab, thrown = Lab(flown, uavs_per_node=1), 0
    for tick in lab.engine.fly():
        if tick not in (22, 42, 62):  # the leader was asked in the tick before
            continue
        receiver = receivers(lab, tick - 1)[name]
        for what, raw, reason in mutations(receiver):
            before = dict(receiver.dropped())
            receiver.deliver(raw)
            after = receiver.dropped()
            found = {why: count - before.get(why, 0) for why, count in after.items() if count != before.get(why, 0)}
            assert found == {reason: 1}, what
            thrown += 1
    summary = lab.world.finish()
    assert thrown >= 3 * 7
    assert summary["trajectory_sha256"] == honest(scenarios.encode(flown))
    assert (summary["lost"], summary["nodes_lost"], summary["telemetry_blocks_dropped"]) == (0, 0, 0)
    assert sum(summary["dropped_messages"].values()) == (thrown if name.startswith("world") else 0)


@pytest.mark.parametrize(
    ("key", "reason"),
    [("agent-99", "unknown-node"), ("agent-0.2", "unknown-node"), ("world", "unknown-node"), ("*", "wrong-key")],
)
def test_a_reply_under_the_key_of_no_node_is_dropped(key: str, reason: str) -> None:
    lab = Lab(scenario("duration=1"))
    raw = written(Act(NUMBER, 0, np.zeros((6, 5))))
    lab.world.handle(Delivery("message", keys.act(RUN, key), raw))
    assert lab.world.counters.drops == {reason: 1}


# -- replies of a genuine node, in its turn -------------------------------------------------------------------------

ROUNDS = 5  # of every flight, opened in ticks 20, 40 …
Say = Callable[[Act], list[Act | bytes]]


def rule(name: str, *more: str) -> Scenario:
    return scenario("federation.fraction=1.0", f'federation.aggregation="{name}"', *more)


def saying(flown: Scenario, node: str, say: Say) -> Lab:
    """A flight in which a node says `say` of every act of its, in place of it."""
    lab = Lab(flown, uavs_per_node=1)
    client = lab.client_of(node)
    put = client._bus.put

    def speak(key: str, raw: bytes) -> None:
        act = read(raw)
        for message in say(act) if isinstance(act, Act) else [raw]:
            put(key, message if isinstance(message, bytes) else written(message))

    client._bus.put = speak  # type: ignore[method-assign]
    return lab


def frames(kind: FrameKind, number: int, uav: int, payload: np.ndarray) -> Frames:
    return Frames(kind, number, np.array([uav], np.int32), payload)


def only(act: Act, *outbox: Frames) -> Act:
    return replace(act, outbox=outbox)


def poison(value: float) -> Say:
    """One weight of each upload is replaced, in bytes that the encoder of an honest node would not have made."""

    def say(act: Act) -> list[Act | bytes]:
        uploads = [batch for batch in act.outbox if batch.kind == FrameKind.UPLOAD]
        if not uploads:
            return [act]
        raw, weights = written(act), uploads[0].payload.copy()
        at = raw.index(weights.tobytes())
        weights[0, 0] = value
        return [raw[:at] + weights.tobytes() + raw[at + weights.nbytes :]]

    return say


def and_honest(say: Say) -> Say:
    """The honest act comes after what is said in place of it."""
    return lambda act: [*(message for message in say(act) if message is not act), act]


def at(when: int, make: Callable[[Act], Act]) -> Say:
    return lambda act: [make(act), act] if act.tick == when else [act]


def relay(**changes: Callable[[Frames], np.ndarray]) -> Say:
    """A relay with other arrays, and then the honest one."""

    def say(act: Act) -> list[Act | bytes]:
        for batch in act.outbox:
            if batch.kind == FrameKind.RELAY:
                parts = {"source": batch.source, "payload": batch.payload, "links": batch.links}
                parts |= {name: make(batch) for name, make in changes.items()}
                return [only(act, Frames(batch.kind, batch.round, *parts.values())), act]
        return [act]

    return say


def counted(count: float) -> Say:
    return relay(payload=lambda batch: np.append(batch.payload[:, :-1], [[count]], axis=1).astype(batch.payload.dtype))


def stray_relay(uav: int) -> Say:
    return at(30, lambda act: only(act, frames(FrameKind.RELAY, 1, uav, np.ones((1, FLOATS + 1), np.float32))))


def refusing(when: int, *refused: int) -> Say:
    return at(when, lambda act: Act(act.run, act.tick, act.commands, refused=np.array(refused)))


def uninvited(clusters: int) -> tuple[Scenario, list[int]]:
    """A flight in which UAV 11 takes no part in some rounds, and those rounds."""
    flown = swarm("federation.fraction=0.5", clusters=clusters)
    idle = [number for number in range(1, ROUNDS + 1) if 11 not in Schedule(flown).participants(number)]
    assert 0 < len(idle) < ROUNDS
    return flown, idle


def upload_of_11(idle: list[int]) -> Say:
    def say(act: Act) -> list[Act | bytes]:
        number, rest = divmod(act.tick, PERIOD)
        batch = frames(FrameKind.UPLOAD, number, 11, np.full((1, FLOATS), 5.0, np.float32))
        return [only(act, batch) if not rest and number in idle else act]

    return say


def upload_between_rounds(act: Act) -> list[Act | bytes]:
    batch = frames(FrameKind.UPLOAD, act.tick + 1, 2, np.zeros((1, FLOATS), np.float32))
    return [act if act.outbox else only(act, batch)]


class Case(NamedTuple):
    flown: Scenario
    node: str
    say: Say
    dropped: dict[str, int]


HEADS, FLAT, AVERAGED = swarm(), swarm(clusters=1), {"wrong-shape": ROUNDS}
ONCE = {"wrong-shape": 1}
CASES: dict[str, Case] = {
    "a weight that is not finite": Case(rule("median"), "agent-3", and_honest(poison(np.inf)), {"non-finite": ROUNDS}),
    "an upload between rounds": Case(rule("fedavg"), "agent-2", upload_between_rounds, {"wrong-round": 120 - ROUNDS}),
    **{
        f"an upload uninvited, {clusters} clusters": Case(
            flown, "agent-11", upload_of_11(idle), {"wrong-round": len(idle)}
        )
        for clusters in (1, 3)
        for flown, idle in [uninvited(clusters)]
    },
    "a relay of more models than its cluster has": Case(HEADS, "agent-4", counted(5.0), AVERAGED),
    "a relay of half a model": Case(HEADS, "agent-4", counted(0.5), AVERAGED),
    "a relay of no model": Case(HEADS, "agent-4", counted(0.0), AVERAGED),
    "a relay without a count": Case(HEADS, "agent-4", relay(payload=lambda batch: batch.payload[:, :-1]), AVERAGED),
    "a relay in doubles": Case(HEADS, "agent-4", relay(payload=lambda batch: batch.payload.astype("<f8")), AVERAGED),
    "a relay of another head": Case(HEADS, "agent-4", relay(source=lambda batch: batch.source + 4), AVERAGED),
    "a relay of a UAV that is no head": Case(HEADS, "agent-4", relay(source=lambda batch: batch.source + 1), AVERAGED),
    "a relay with links": Case(HEADS, "agent-4", relay(links=lambda batch: np.zeros((1, 2), np.int32)), AVERAGED),
    "a relay by a node without a head": Case(HEADS, "agent-5", stray_relay(5), ONCE),
    "a relay between rounds": Case(HEADS, "agent-4", stray_relay(4), {"wrong-round": 1, "duplicate": 1}),
    "a relay without clusters": Case(FLAT, "agent-0", stray_relay(0), {"wrong-kind": 1}),
    **{  # a head refuses uploads (~uav) of its own cluster once, and only when it averages
        f"a refusal of {refused} in tick {when}": Case(HEADS, "agent-4", refusing(when, *refused), ONCE)
        for when, refused in [
            *((21, (~0,)), (21, (~5, ~5)), (21, (~12,)), (20, (~5,))),
            *((21, (5, 5)), (21, (12,)), (20, (5, 5)), (30, (4,))),
        ]
    },
}


@pytest.mark.parametrize("what", CASES)
def test_a_false_reply_of_a_genuine_node_is_dropped_for_its_reason_and_the_flight_is_the_same(what: str) -> None:
    flown, node, say, dropped = CASES[what]
    lab = saying(flown, node, say)
    summary = lab.fly()
    assert summary["dropped_messages"] == dropped
    assert summary["trajectory_sha256"] == honest(scenarios.encode(flown))
    assert (summary["uploads_refused"], summary["states_refused"]) == (0, 0)
    assert not any(box._frames for _, box in lab.world.post._boxes)


def test_a_node_that_sends_nothing_else_is_lost_and_the_others_average_without_it() -> None:
    lab = saying(rule("fedavg"), "agent-3", poison(np.nan))
    times = itertools.count()
    lab.world._waiting._clock = lambda: float(next(times))  # the barrier's patience ends at once
    summary = lab.fly()
    assert summary["dropped_messages"]["non-finite"] >= 1
    assert (summary["lost"], summary["nodes_lost"], summary["rounds"]) == (1, 1, ROUNDS)


def test_the_leader_refuses_a_finite_weight_beyond_all_bounds() -> None:
    summary = saying(rule("fedavg"), "agent-3", poison(1e30)).fly()
    assert summary["dropped_messages"] == {}
    assert 0 < summary["uploads_refused"] <= ROUNDS  # an outage may have kept one from the leader
    assert summary["rounds"] == ROUNDS


def test_a_node_cannot_take_the_uploads_of_all_to_another_round() -> None:
    """Frames of a kind go on the air together, those of UAV 0 first; its round must not be that of all."""
    flown = rule("fedavg", "federation.leader=5")
    silent = saying(flown, "agent-0", lambda act: [only(act) if act.outbox else act]).fly()

    def elsewhere(act: Act) -> list[Act | bytes]:
        return [only(act, *(Frames(batch.kind, 2**31, batch.source, batch.payload) for batch in act.outbox))]

    lab = saying(flown, "agent-0", elsewhere)
    summary = lab.fly()
    assert summary["dropped_messages"] == {"wrong-round": ROUNDS}
    assert summary["rounds"] == ROUNDS
    assert summary["trajectory_sha256"] == silent["trajectory_sha256"]
    assert not any(box._frames for _, box in lab.world.post._boxes)


@pytest.mark.parametrize(
    ("when", "refused", "counts"), [(PERIOD, (5,), (0, 1)), (PERIOD + 1, (5,), (0, 1)), (PERIOD + 1, (~5, 5), (1, 1))]
)
def test_states_and_uploads_that_a_head_refuses_are_counted_apart(
    when: int, refused: tuple[int, ...], counts: tuple[int, int]
) -> None:
    def say(act: Act) -> list[Act | bytes]:
        return [replace(act, refused=np.array(refused)) if act.tick == when else act]

    summary = saying(HEADS, "agent-4", say).fly()
    assert (summary["dropped_messages"], summary["uploads_refused"], summary["states_refused"]) == ({}, *counts)


def test_a_head_that_lies_speaks_for_its_cluster_and_no_more() -> None:
    """The documented limit: its relay weighs as much as its cluster has UAVs."""
    flown = swarm("federation.fraction=1.0", *CLEAR)
    lie = np.full(FLOATS, 7.0)

    def say(act: Act) -> list[Act | bytes]:
        false = frames(FrameKind.RELAY, 1, 4, np.append(lie, 4.0)[None])
        return [only(act, false) if act.tick == PERIOD + 1 else act]

    lab, heard = saying(flown, "agent-4", say), list[np.ndarray]()
    lab.listen(lambda tick, batch: heard.append(batch.payload[0]) if batch.kind == FrameKind.GLOBAL else None)
    lab.fly()
    truth = globals_of(flown)[0]
    others = (3 * heard[0] - lie) / 2  # the mean of the other eight
    assert np.abs(heard[0] - truth).max() > 1
    assert np.abs(others - truth).max() < 1
