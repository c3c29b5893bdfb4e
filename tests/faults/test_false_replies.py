"""Replies of a genuine node in its turn: what others drop, refuse or do not believe, and the documented limits."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.agent.controllers.base import plausible
from meanflock.federation.plan import plan_of
from meanflock.federation.schedule import Schedule
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.faults.clusters import CLEAR, FLOATS, PERIOD, globals_of, swarm
from tests.faults.conftest import Lab, Say, honest, saying, scenario
from tests.swarm.examples import written

replace = msgspec.structs.replace
ROUNDS = 5  # of every flight, opened in ticks 20, 40 …


def rule(name: str, *more: str) -> Scenario:
    return scenario("federation.fraction=1.0", f'federation.aggregation="{name}"', *more)


def frames(kind: FrameKind, number: int, uav: int, payload: np.ndarray) -> Frames:
    return Frames(kind, number, np.array([uav], np.int32), payload)


def only(act: Act, *outbox: Frames) -> Act:
    return replace(act, outbox=outbox)


def poisoned_and_honest(act: Act) -> Iterator[Act | bytes]:
    """A weight of each upload is infinite, in bytes that the encoder of an honest node would not have made."""
    for batch in act.outbox:
        if batch.kind == FrameKind.UPLOAD:
            raw, weights = written(act), batch.payload.copy()
            at = raw.index(weights.tobytes())
            weights[0, 0] = np.inf
            yield raw[:at] + weights.tobytes() + raw[at + weights.nbytes :]
    yield act


def at(when: int, make: Callable[[Act], Act]) -> Say:
    return lambda act: [make(act), act] if act.tick == when else [act]


def relaying(uav: int) -> Say:
    return at(30, lambda act: only(act, frames(FrameKind.RELAY, 1, uav, np.ones((1, FLOATS + 1), np.float32))))


def naming(when: int, list_: str, *uavs: int) -> Say:
    return at(when, lambda act: Act(act.run, act.tick, act.commands, **{list_: np.array(uavs)}))


def upload_between_rounds(act: Act) -> list[Act | bytes]:
    batch = frames(FrameKind.UPLOAD, act.tick + 1, 2, np.zeros((1, FLOATS), np.float32))
    return [act if act.outbox else only(act, batch)]


class Case(NamedTuple):
    flown: Scenario
    node: str
    say: Say
    dropped: dict[str, int]


def uninvited(clusters: int) -> Case:
    """UAV 11 uploads in the rounds in which it takes no part."""
    flown = swarm("federation.fraction=0.5", clusters=clusters)
    idle = [number for number in range(1, ROUNDS + 1) if 11 not in Schedule(plan_of(flown)).participants(number)]
    assert 0 < len(idle) < ROUNDS

    def say(act: Act) -> list[Act | bytes]:
        number, rest = divmod(act.tick, PERIOD)
        batch = frames(FrameKind.UPLOAD, number, 11, np.full((1, FLOATS), 5.0, np.float32))
        return [only(act, batch) if not rest and number in idle else act]

    return Case(flown, "agent-11", say, {"wrong-round": len(idle)})


HEADS = swarm()
CASES: dict[str, Case] = {
    "a weight that is not finite": Case(rule("median"), "agent-3", poisoned_and_honest, {"non-finite": ROUNDS}),
    "an upload between rounds": Case(rule("fedavg"), "agent-2", upload_between_rounds, {"wrong-round": 120 - ROUNDS}),
    "an upload uninvited": uninvited(clusters=1),
    "an upload uninvited, to a head": uninvited(clusters=3),
    "a relay between rounds": Case(HEADS, "agent-4", relaying(4), {"wrong-round": 1, "duplicate": 1}),
    "a relay without clusters": Case(swarm(clusters=1), "agent-0", relaying(0), {"wrong-kind": 1}),
    "an upload refused before the head averages": Case(
        HEADS, "agent-4", naming(20, "refused_uploads", 5), {"wrong-shape": 1}
    ),
    "a wait before the head averages": Case(HEADS, "agent-4", naming(20, "waiting", 4), {"wrong-shape": 1}),
    "a wait at another head": Case(HEADS, "agent-4", naming(21, "waiting", 8), {"wrong-shape": 1}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_false_reply_of_a_genuine_node_is_dropped_for_its_reason_and_the_flight_is_the_same(case: str) -> None:
    flown, node, say, dropped = CASES[case]
    lab = saying(flown, node, say)
    summary = lab.fly()
    assert summary["dropped_messages"] == dropped
    assert summary["trajectory_sha256"] == honest(flown)
    assert (summary["uploads_refused"], summary["states_refused"]) == (0, 0)
    assert lab.world.ledger.letters == ()


@pytest.mark.parametrize(
    ("when", "uploads", "counts"), [(PERIOD, (), (0, 1)), (PERIOD + 1, (), (0, 1)), (PERIOD + 1, (5,), (1, 1))]
)
def test_states_and_uploads_that_a_head_refuses_are_counted_apart(when, uploads, counts) -> None:
    def say(act: Act) -> list[Act | bytes]:
        refused = {"refused_uploads": np.array(uploads, np.int32), "refused_states": np.array([5])}
        return [replace(act, **refused) if act.tick == when else act]

    summary = saying(HEADS, "agent-4", say).fly()
    assert (summary["dropped_messages"], summary["uploads_refused"], summary["states_refused"]) == ({}, *counts)


def test_a_head_that_lies_speaks_for_its_cluster_and_no_more() -> None:
    """The documented limit: its relay weighs as much as its cluster has UAVs."""
    flown = swarm("federation.fraction=1.0", *CLEAR)
    lie = np.full(FLOATS, 7.0)

    def say(act: Act) -> list[Act | bytes]:
        false = frames(FrameKind.RELAY, 1, 4, np.append(lie, 4.0)[None])
        return [only(act, false) if act.tick == PERIOD + 1 else act]

    heard, truth = globals_of(saying(flown, "agent-4", say))[0], globals_of(Lab(flown))[0]
    others = (3 * heard - lie) / 2  # the mean of the other eight
    assert np.abs(heard - truth).max() > 1
    assert np.abs(others - truth).max() < 1


LIAR = 3
TICKS = 120


def flock(*settings: str) -> Scenario:
    return load(None, ["uavs=6", f"duration={TICKS / 10}", *settings], method="hjb")


def claiming(speed: float, x: float | None = None) -> Say:
    """The node broadcasts this speed in m/s, and this position, of its UAV."""

    def say(act: Act) -> list[Act | bytes]:
        batches = []
        for batch in act.outbox:
            payload = batch.payload.copy()
            payload[:, 2:] = speed / np.sqrt(2.0)
            payload[:, 0] = payload[:, 0] if x is None else x
            batches.append(Frames(batch.kind, batch.round, batch.source, payload))
        return [replace(act, outbox=tuple(batches))]

    return say


@pytest.mark.parametrize(
    ("say", "is_believed"),
    [(claiming(1e6), False), (claiming(0.0, x=1e7), False), (claiming(99.0), True)],
    ids=["an impossible speed", "a position out of reach", "a speed that could be true"],
)
def test_a_state_that_no_uav_can_have_is_not_used_counted_and_named(say: Say, is_believed: bool) -> None:
    lab = saying(flock(), f"agent-{LIAR}", say)
    summary = lab.fly()
    texts = [(event.tick, event.text) for event in lab.record.events if "states of UAV" in event.text]
    assert (summary["lost"], summary["dropped_messages"]) == (0, {})
    # Sent in every tick after the first and received one later; counted once a tick, and one event.
    assert summary["states_refused"] == (0 if is_believed else TICKS - 2)
    assert texts == ([] if is_believed else [(2, f"states of UAV {LIAR} were not believed: no UAV can be so")])
    assert is_believed or summary["phi_A"] == pytest.approx(honest(flock(), "phi_A"), rel=0.1)


@pytest.mark.parametrize("settings", [(), ("wind.sigma=2",), ("radio.bits_per_float=16",)])
def test_honest_states_are_used(settings: tuple[str, ...]) -> None:
    assert honest(flock(*settings), "states_refused") == 0


@given(st.floats(0.0, 300.0), st.floats(0.0, 2 * np.pi), st.sampled_from([50.0, 100.0]))
def test_a_state_is_used_exactly_if_its_speed_is_below_the_bound(speed: float, heading: float, bound: float) -> None:
    check = plausible(load(None, [f"radio.plausible_speed={bound}"]))
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    assert not check(np.array([[0, 0, 65536, 0]], dtype=np.int32)).any()  # its square is 0 in 32 bits
    if abs(speed - bound) > 1e-9 * bound:
        assert check(np.array([[150.0, 100.0, *velocity]])).tolist() == [speed < bound]
