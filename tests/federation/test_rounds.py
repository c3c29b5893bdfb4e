"""A node's part in the rounds: who averages, what is refused or sent once, frames that do not fit; means and bills."""

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import meanflock as mf
from meanflock.agent.node import Agent
from meanflock.federation.codec import Codec
from meanflock.federation.cut import coding_of
from meanflock.federation.plan import plan_of
from meanflock.federation.rounds import Rounds
from meanflock.federation.rules.base import mean
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.clusters import Division
from meanflock.launch.engine import Engine
from meanflock.leader.node import Leader
from meanflock.net import tick as wire
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.agent.nodes import flown, sense, welcome
from tests.faults.clusters import CLEAR, FLOATS, PERIOD, ROUGH
from tests.faults.conftest import Lab, scenario
from tests.federation.plugins import Long


def clustered(*settings: str) -> Scenario:
    """Clusters {0 1 2}, {3 4 5} and {6 7}; UAV 4 leads, so the heads are 0, 4 and 6."""
    fixed = ["uavs=8", "federation.period=10", "federation.clusters=3", "federation.leader=4"]
    return load(None, [*fixed, *settings], method="mfgfl-h")


def heads(*uavs: int, flight: Scenario | None = None) -> Rounds:
    """The part of an agent; the relays of round k are due in tick 10 k + 1."""
    nobody = np.zeros(len(uavs), dtype=bool)
    return Rounds(plan_of(flight or clustered()), "agent", np.array(uavs), [], SimpleNamespace(silent=lambda: nobody))


def model(uav: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng([uav, seed]).standard_normal(108).astype(np.float32)


def uploads(source: list[int], to: list[int], number: int = 1, seed: int = 0) -> Frames:
    payload = np.stack([model(uav, seed) for uav in source])
    links = np.array([[row, head] for row, head in enumerate(to)], dtype=np.int32).reshape(-1, 2)
    return Frames(FrameKind.UPLOAD, number, np.array(source, dtype=np.int32), payload, links)


def rows_of(codec: Codec, models: np.ndarray) -> np.ndarray:
    return codec.rows(codec.encode(models, np.arange(len(models)), 1), np.ones((len(models), 1)))


def average(*uavs: int) -> np.ndarray:
    return mean(np.stack([model(uav) for uav in uavs]).astype(np.float64)).astype(np.float32)


def test_a_second_copy_changes_nothing_and_mail_of_a_closed_round_is_dropped() -> None:
    node = heads(0)
    node.receive(uploads([1, 2], [0, 0]), 11)
    node.receive(uploads([1], [0], seed=9), 11)
    (sent,), _ = node.act(11)
    np.testing.assert_array_equal(sent.payload[0], np.append(average(1, 2), 2))
    node.receive(uploads([0], [0], number=2), 21)
    node.receive(uploads([1], [0]), 21)  # too late for its round
    (sent,), _ = node.act(21)
    np.testing.assert_array_equal(sent.payload[0], np.append(average(0), 1))


def test_a_head_refuses_absurd_models_and_sends_nothing_if_it_has_no_others() -> None:
    node, batch = heads(0, 6), uploads([1, 2, 7], [0, 0, 6])
    batch.payload[[0, 2], 5] = 1e10
    node.receive(batch, 11)
    (sent,), refused = node.act(11)
    assert (sent.source.tolist(), refused) == ([0], [1, 7])
    np.testing.assert_array_equal(sent.payload[0], np.append(average(2), 1))


def test_a_mean_that_no_float_of_the_radio_can_hold_is_not_sent() -> None:
    flight = clustered("radio.bits_per_float=16", "federation.payload=int8")
    written = rows_of(plan_of(flight).hops[0].codec, np.stack([np.full(108, 1e8), np.full(108, 2.0)]))
    node, links = heads(0, 6, flight=flight), np.array([[0, 0], [1, 6]], dtype=np.int32)
    node.receive(Frames(FrameKind.UPLOAD, 1, np.array([1, 7], np.int32), written, links), 11)
    (sent,), refused = node.act(11)
    assert (sent.source.tolist(), sent.payload.dtype, refused) == ([6], np.float16, [])


LEADER = ("method=mfgfl-h", "federation.leader=3")


def closing(case: Scenario, number: int) -> int:
    return next(tick for tick in range(1000) if Schedule(plan_of(case)).closes(tick) == number)


@pytest.mark.parametrize("down", ["int8", "float16", "float32"])
def test_a_leader_averages_what_bytes_stand_for_and_broadcasts_once_in_its_own_coding(down: str) -> None:
    case = flown(*LEADER, "federation.payload=int8", f"federation.broadcast_payload={down}")
    node, up = Leader(welcome(case, ())), plan_of(case).hops[0].codec
    batch = uploads([0, 1, 6], [3, 3, 3])
    written = Frames(batch.kind, 1, batch.source, rows_of(up, batch.payload.astype(np.float64)), batch.links)
    act = node.act(sense(closing(case, 1), written, uavs=()))
    (sent,) = act.outbox
    heard = up.read(written.payload).values
    broadcast = Codec(coding_of(case, down), plan_of(case).declared.parts)
    expected = rows_of(broadcast, ((heard[0] + heard[1]) + heard[2])[None] / 3)
    assert (sent.kind, sent.round, sent.source.tolist(), sent.links) == (FrameKind.GLOBAL, 1, [3], None)
    assert (sent.payload.dtype, sent.payload.tobytes()) == (expected.dtype, expected.tobytes())
    assert isinstance(wire.read_act(wire.write_act(act)), Act)
    assert not node.act(sense(closing(case, 1) + 1, written, uavs=())).outbox


def test_an_absurd_relay_is_refused_by_the_name_of_its_head() -> None:
    case = flown(*LEADER, "federation.clusters=3")
    relayed = [np.append(model(uav), count) for uav, count in ((0, 3), (6, 2))]
    relayed[0][5] = 1e10
    links = np.array([[0, 3], [1, 3]], dtype=np.int32)
    batch = Frames(FrameKind.RELAY, 1, np.array([0, 6], np.int32), np.array(relayed, np.float32), links)
    act = Leader(welcome(case, ())).act(sense(closing(case, 1), batch, uavs=()))
    assert act.refused_uploads.tolist() == [0]
    np.testing.assert_array_equal(act.outbox[0].payload[0], model(6))


UPLOAD, RELAY, GLOBAL, STATE = FrameKind.UPLOAD, FrameKind.RELAY, FrameKind.GLOBAL, FrameKind.STATE
# Eight UAVs; with heads the clusters are {0 1 2}, {3 4 5} and {6 7}, led by 0, 4 and 6, and 4 leads all.
HEADS = ("federation.clusters=3", "federation.leader=4")


def blank(kind: FrameKind, width: int, source: list[int], links: Any, dtype: str = "<f4", last: float = 0.0) -> Frames:
    """Models of zeros but for their last number."""
    payload = np.zeros((len(source), width), dtype)
    payload[:, -1] = last
    on_wire = None if links is None else np.array(links, dtype=np.int32)
    return Frames(kind, int(kind != STATE), np.array(source, dtype=np.int32), payload, on_wire)


def relay(source: int, count: float, width: int = 109) -> Frames:
    return blank(RELAY, width, [source], [[0, 4]], last=count)


class Node(NamedTuple):
    """Settings of the flight, a tick in which frames arrive, the node's UAVs (none: the leader), and the frames."""

    settings: tuple[str, ...]
    tick: int
    uavs: tuple[int, ...]
    fitting: tuple[Frames, ...]
    misfits: dict[str, Frames]


MODELS: dict[str, Frames] = {  # of a flat federation of 108 floats, for an agent of the UAVs 2, 3 and 5
    "an upload": blank(UPLOAD, 108, [0], [[0, 2]]),
    "a relay": blank(RELAY, 109, [0], [[0, 2]]),
    "no links": blank(GLOBAL, 108, [0], None),
    "too short": blank(GLOBAL, 107, [0], [[0, 2]]),
    "to a UAV of another node": blank(GLOBAL, 108, [0], [[0, 4]]),
    "in doubles": blank(GLOBAL, 108, [0], [[0, 2]], "<f8"),
}
UPLOADS: dict[str, Frames] = {
    "a global model": blank(GLOBAL, 108, [0, 1], [[0, 0], [1, 0]]),
    "a state": blank(STATE, 108, [0, 1], [[0, 0], [1, 0]]),
    "a relay without heads": relay(3, 2.0),
}
RELAYS: dict[str, Frames] = {
    "an upload": blank(UPLOAD, 108, [0, 1], [[0, 4], [1, 4]]),
    "of no model": relay(0, 0.0),
    "of no head": relay(5, 2.0),
    "without a count": relay(0, 2.0, width=108),
}
TO_HEADS: dict[str, Frames] = {
    "to a UAV that heads nothing": blank(UPLOAD, 108, [4], [[0, 5]]),
    "to another cluster": blank(UPLOAD, 108, [1], [[0, 4]]),
}
BYTES = {  # 108 steps and two scales
    "floats": blank(UPLOAD, 108, [1], [[0, 0]]),
    "floats of as many columns": blank(UPLOAD, 116, [1], [[0, 0]]),
    "no scales": blank(UPLOAD, 108, [1], [[0, 0]], "u1"),
    "a byte too few": blank(UPLOAD, 115, [1], [[0, 0]], "u1"),
}
TO_ALL = [[0, 2], [0, 3], [0, 5]]
NODES = {
    "agent": Node((), 7, (2, 3, 5), (blank(GLOBAL, 108, [0], TO_ALL, last=1.0),), MODELS),
    "leader": Node((), 6, (), (blank(UPLOAD, 108, [7], [[0, 0]]),), UPLOADS),
    "leader of int8": Node(("federation.payload=int8",), 6, (), (), BYTES),
    "leader of doubles": Node(("radio.bits_per_float=64",), 6, (), (), {"floats": blank(UPLOAD, 108, [1], [[0, 0]])}),
    "leader of heads": Node(HEADS, 7, (), (relay(6, 2.0),), RELAYS),
    "heads": Node(HEADS, 6, (0, 4, 5, 6), (blank(UPLOAD, 108, [1, 3, 7], [[0, 0], [1, 4], [2, 6]]),), TO_HEADS),
    "no head": Node(HEADS, 6, (1, 2, 3), (), {"an upload": blank(UPLOAD, 108, [1], [[0, 0]])}),
}
CASES = [(name, misfit) for name, node in NODES.items() for misfit in node.misfits]


@pytest.mark.parametrize(("name", "misfit"), CASES)
def test_a_request_with_a_frame_that_does_not_fit_is_rejected_and_nothing_has_changed(name: str, misfit: str) -> None:
    settings, tick, uavs, fitting, misfits = NODES[name]
    flight = flown("method=mfgfl-h", *settings)
    node, untouched, other = (Agent(welcome(flight, uavs)) if uavs else Leader(welcome(flight, ())) for _ in range(3))
    with pytest.raises(MessageRejected):
        node.act(wire.read_sense(wire.write_sense(sense(tick, *fitting, misfits[misfit], uavs=uavs)), uavs=flight.uavs))
    replies = [wire.write_act(one.act(sense(tick, uavs=uavs))) for one in (node, untouched)]
    assert replies[0] == replies[1]
    if fitting:
        assert wire.write_act(other.act(sense(tick, *fitting, uavs=uavs))) != replies[0]


# -- means and bills of one level and of two ------------------------------------------------------------------------

BY_SAMPLES = ("controller.by_samples=true", f"controller.length={FLOATS}")


def one_round(flight: Scenario) -> tuple[list[np.ndarray], list[int]]:
    """What the leader broadcasts, and the UAVs whose model got through all hops."""
    engine, found, records = Engine(flight, "round"), list[np.ndarray](), list[np.ndarray]()
    send = engine.world.air.send

    def noted(tick: int, frames: list[Frames], *more: Any) -> np.ndarray:
        found.extend(batch.payload[0] for batch in frames if batch.kind == GLOBAL)
        records.append(send(tick, frames, *more).copy())
        return records[-1]

    engine.world.air.send = noted
    engine.complete()
    links = np.concatenate(records)
    lost, silent = (set(links[(links[:, 3] == kind) & (links[:, 5] == 0), 1].tolist()) for kind in (UPLOAD, RELAY))
    head_of = Division(flight).head_of if flight.federation.clusters > 1 else np.full(flight.uavs, -1)
    taking_part = Schedule(plan_of(flight)).participants(1).tolist()
    return found, [uav for uav in taking_part if uav not in lost and head_of[uav] not in silent]


@st.composite
def rounds_of(draw: st.DrawFn) -> list[str]:
    """Settings of a swarm with clusters that flies one round, without a change of its models before."""
    uavs = draw(st.integers(1, 40))
    return [
        *("method=long", "controller.decay=1.0", f"controller.length={FLOATS}", f"federation.period={PERIOD}"),
        *('stop="duration"', "duration=2.8", f"uavs={uavs}", f"seed={draw(st.integers(0, 2**62))}"),
        f"controller.by_samples={draw(st.sampled_from(['true', 'false']))}",
        f"federation.clusters={draw(st.integers(1, uavs))}",
        f"federation.leader={draw(st.integers(0, uavs - 1))}",
        f"federation.fraction={draw(st.floats(0.01, 1.0))}",
    ]


@pytest.mark.parametrize("radio", [CLEAR, ROUGH], ids=["clear", "rough"])
def test_the_mean_on_one_level_and_on_two_is_that_of_the_models_that_got_through(radio: tuple[str, ...]) -> None:
    mf.register(Long)

    @settings(max_examples=40, deadline=None, database=None)
    @given(rounds_of())
    def check(asked: list[str]) -> None:
        for levels in ((), ("federation.clusters=1",)):
            case = load(None, [*asked, *radio, *levels])
            found, through = one_round(case)
            assert radio is ROUGH or through == Schedule(plan_of(case)).participants(1).tolist()
            assert (not found) == (set(through) <= {case.federation.leader})  # no model of another UAV arrived
            if found:
                before = Long(Long.Options(length=FLOATS), case).init(np.array(through), np.zeros((len(through), 4)))
                expected = mean(before["model"], before["samples"] if plan_of(case).declared.weighted else None)
                np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-12)

    check()


@pytest.mark.parametrize(("leader", "bits", "options"), [(0, 32, ()), (5, 64, ()), (7, 16, ()), (0, 64, BY_SAMPLES)])
def test_both_levels_are_billed_as_counted_by_hand(leader: int, bits: int, options: tuple[str, ...]) -> None:
    """8 UAVs, 3 clusters {0 1 2}, {3 4 5}, {6 7}; all upload; five rounds."""
    mf.register(Long)
    case = scenario(
        "uavs=8", "federation.clusters=3", "federation.fraction=1.0", f"federation.leader={leader}",
        f"radio.bits_per_float={bits}", "radio.target_snr_db=60", *options, method="long" if options else "mfgfl-h",
    )  # fmt: skip
    samples = 32 if options else 0
    lab = Lab(case)
    summary = lab.fly()
    traffic = summary["radio"]["traffic"]
    assert summary["rounds"] == 5
    assert traffic["uplink"]["transmissions"] == traffic["uplink"]["sent"] == 5 * (8 - 3)  # heads need no radio
    assert traffic["relay"]["transmissions"] == traffic["relay"]["sent"] == 5 * (3 - 1)  # nor does the leader's own
    assert summary["payload_bits"] == {
        "uplink": 25 * (FLOATS * bits + samples),
        "relay": 10 * ((FLOATS + 1) * bits + samples),
        "broadcast": 5 * FLOATS * bits,
        "state": 8 * 4 * bits,
        "total": (30 * FLOATS + 10 * (FLOATS + 1)) * bits + 35 * samples + 32 * bits,
    }
    heads = {0: (0, 3, 6), 5: (0, 5, 6), 7: (0, 3, 7)}[leader]
    members = ((0, 1, 2), (3, 4, 5), (6, 7))
    up = {(uav, head) for head, group in zip(heads, members, strict=True) for uav in group if uav != head}
    relays = {(head, leader) for head in heads if head != leader}
    links = np.concatenate([block.links for block in lab.record.blocks])
    for kind, expected, ticks in ((FrameKind.UPLOAD, up, 0), (FrameKind.RELAY, relays, 1), (FrameKind.GLOBAL, None, 2)):
        of_kind = links[links[:, 3] == kind]
        assert sorted(set(of_kind[:, 0].tolist())) == [20 + ticks, 40 + ticks, 60 + ticks, 80 + ticks, 100 + ticks]
        assert expected is None or {(int(s), int(t)) for s, t in of_kind[:, 1:3]} == expected
