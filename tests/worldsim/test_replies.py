"""The reply of a node: the world accepts what this node can send in this tick, and merges the frames of all nodes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.channel.meter import Meter
from meanflock.federation import coding as codings
from meanflock.federation.post import Post
from meanflock.federation.schedule import Schedule
from meanflock.swarm.declared import MAX_BROADCASTS
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import FrameMerger, Replies
from tests.swarm.examples import same

RUN, TICK = 0xC0FFEE42, 20
QUICK = settings(max_examples=200, deadline=None, database=None)
STATES = load(None, ["uavs=8"], method="hjb")
MODELS = load(None, ["uavs=8", "federation.period=10"], method="mfgfl-hf")
BYTES = MODELS.replace(**{"federation.payload": "int8"})
ALL = MODELS.replace(**{"federation.fraction": 1.0})
MOST = STATES.declared.broadcast_numbers  # of a UAV in a tick
LEADER = Member("leader", "leader", np.zeros(0, np.intp))
INTEGERS = ("i1", "u1", "<i2", "<i4")


def member(*uavs: int) -> Member:
    return Member(f"agent-{uavs[0]}", "agent", np.array(uavs))


def broadcast(*uavs: int, dtype: Any = "<f4", width: int = 4, number: int = 0) -> Frames:
    payload = np.random.default_rng(len(uavs) + width).integers(0, 99, (len(uavs), width)).astype(dtype)
    return Frames(FrameKind.STATE, number, np.array(uavs, np.int32), payload)


def upload(flown: Scenario, *uavs: int, number: int = 2) -> Frames:
    coding = codings.of_uploads(flown)
    models = np.random.default_rng(uavs[0]).normal(size=(len(uavs), coding.floats))
    return Frames(FrameKind.UPLOAD, number, np.array(uavs, np.int32), coding.encode(models))


def reply(flown: Scenario, *uavs: int, outbox: tuple[Frames, ...] = (), report: bool = False, **changes: Any) -> Act:
    commands = np.full((len(uavs), 2 + len(flown.declared.diagnostics)), 0.25)
    models = np.full((len(uavs), 246), 0.5) if report else None
    return Act(**{"run": RUN, "tick": TICK, "commands": commands, "outbox": outbox, "models": models, **changes})


def read(flown: Scenario, raw: bytes, by: Member) -> Act:
    return Replies(flown, RUN, Post(flown), lambda rows: 2**16).read(by, TICK, raw)


@pytest.mark.parametrize("report", [False, True])
@pytest.mark.parametrize("uavs", [(3,), (2, 3, 5), tuple(range(8))])
def test_a_reply_is_accepted_as_it_was_written(report: bool, uavs: tuple[int, ...]) -> None:
    outboxes: list[tuple[Scenario, tuple[Frames, ...]]] = [(STATES, ())]
    for bits, dtype in FLOAT_OF_BITS.items():
        outboxes.append((STATES.replace(**{"radio.bits_per_float": bits}), (broadcast(*uavs, dtype=dtype),)))
    for payload in ("float32", "float16", "int8"):
        flown = MODELS.replace(**{"federation.payload": payload})
        outboxes.append((flown, (upload(flown, *uavs),)))
    for flown, outbox in outboxes:
        act = reply(flown, *uavs, outbox=outbox, report=report)
        same(read(flown, wire.write_act(act), member(*uavs)), act)


def test_broadcasts_of_any_width_and_type_of_some_rows_are_accepted() -> None:
    frames = [broadcast(3, 5, dtype=name, width=width, number=width) for width, name in enumerate(INTEGERS, 1)]
    frames += [broadcast(2, width=MOST), broadcast(2, 5, number=MAX_BROADCASTS - 1)]
    act = reply(STATES, 2, 3, 5, outbox=tuple(frames))
    same(read(STATES, wire.write_act(act), member(2, 3, 5)), act)


def of_kind(kind: FrameKind, width: int, **more: Any) -> Frames:
    return Frames(kind, 1, np.array([3], "<i4"), np.zeros((1, width), "<f4"), **more)


REJECTED: dict[str, tuple[Scenario, tuple[Frames, ...], str]] = {
    "of another node": (STATES, (broadcast(4),), "wrong-shape"),
    "of no UAV": (STATES, (broadcast(8),), "wrong-shape"),
    "of a negative UAV": (STATES, (broadcast(-1),), "wrong-shape"),
    "of a UAV twice": (STATES, (broadcast(3, 3),), "wrong-shape"),
    "descending": (STATES, (broadcast(5, 3),), "wrong-shape"),
    "empty": (STATES, (broadcast(),), "wrong-shape"),
    "of no numbers": (STATES, (broadcast(3, width=0),), "wrong-shape"),
    "too wide": (STATES, (broadcast(3, width=MOST + 1),), "wrong-shape"),
    "too many": (STATES, (broadcast(3, number=MAX_BROADCASTS),), "wrong-shape"),
    "a number twice": (STATES, (broadcast(3), broadcast(5)), "wrong-shape"),
    "wider floats than the radio's": (STATES, (broadcast(3, dtype="<f8"),), "wrong-shape"),
    "narrower floats": (STATES, (broadcast(3, dtype="<f2"),), "wrong-shape"),
    "an upload without rounds": (STATES, (of_kind(FrameKind.UPLOAD, 246),), "wrong-kind"),
    "a global model": (STATES, (of_kind(FrameKind.GLOBAL, 246),), "wrong-kind"),
    "a relay": (STATES, (of_kind(FrameKind.RELAY, 247),), "wrong-kind"),
    "with links": (STATES, (of_kind(FrameKind.STATE, 4, links=np.zeros((1, 2), "<i4")),), "wrong-shape"),
    "an upload of another node": (MODELS, (upload(MODELS, 4),), "wrong-shape"),
    "an upload in bytes": (MODELS, (upload(BYTES, 3),), "wrong-shape"),
    "an upload of another method": (MODELS, (of_kind(FrameKind.UPLOAD, 108),), "wrong-shape"),
    "two uploads": (MODELS, (upload(MODELS, 3), upload(MODELS, 3, number=3)), "wrong-shape"),
}


@pytest.mark.parametrize("what", REJECTED)
def test_frames_that_a_node_cannot_send_are_rejected(what: str) -> None:
    flown, outbox, reason = REJECTED[what]
    with pytest.raises(MessageRejected, match=f"^{reason}"):
        read(flown, wire.write_act(reply(flown, 2, 3, 5, outbox=outbox)), member(2, 3, 5))


def test_a_leader_broadcasts_no_states() -> None:
    with pytest.raises(MessageRejected, match="wrong-kind"):
        read(STATES, wire.write_act(Act(RUN, TICK, np.zeros((0, 2)), outbox=(broadcast(0),))), LEADER)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"tick": TICK + 1}, "stale"),
        ({"run": RUN + 1}, "wrong-run"),
        ({"commands": np.zeros((2, 4))}, "wrong-shape"),
        ({"commands": np.full((1, 4), np.inf)}, "non-finite"),
        ({"models": np.full((1, 246), np.nan)}, "non-finite"),
        ({"models": np.zeros((1, 245))}, "wrong-shape"),
        ({"outbox": (Frames(FrameKind.STATE, 0, np.array([3]), np.full((1, 4), np.nan, "<f4")),)}, "non-finite"),
        ({"lost": np.array([2])}, "wrong-shape"),
        ({"lost": np.zeros(2**16)}, "oversized"),
        ({"refused": np.array([8])}, "wrong-shape"),
        ({"refused": np.array([-1])}, "wrong-shape"),
        ({"refused": np.array([7, 7])}, "wrong-shape"),
        ({"refused": np.array([3])}, "wrong-shape"),  # its own
    ],
)
def test_a_reply_of_another_form_is_rejected(changes: dict[str, Any], reason: str) -> None:
    good = reply(STATES, 3, report=True, refused=np.array([0, 7]))
    assert read(STATES, wire.write_act(good), member(3)).refused.tolist() == [0, 7]
    with pytest.raises(MessageRejected, match=f"^{reason}"):
        read(STATES, wire.write_act(reply(STATES, 3, **changes)), member(3))


@pytest.mark.parametrize(
    ("by", "tick", "uploads", "is_accepted"),
    [
        (member(0, 1), 11, [1, 2], True),
        (member(0, 1), 11, [3], False),  # of another cluster
        (member(0, 1), 12, [1], False),  # its relay is sent in tick 11
        (member(1), 11, [2], False),  # heads nothing
        (LEADER, 12, [3], True),
    ],
)
def test_only_a_node_that_averages_may_refuse_uploads(
    by: Member, tick: int, uploads: list[int], is_accepted: bool
) -> None:
    """Clusters {0 1 2}, {3 4 5} and {6 7}; UAV 4 leads."""
    clusters = {"federation.period": 10, "federation.clusters": 3, "federation.leader": 4}
    flown = Scenario(uavs=8, method="mfgfl-h", **clusters)
    raw = wire.write_act(reply(flown, *by.uavs, tick=tick, refused=~np.array(uploads)))
    replies = Replies(flown, RUN, Post(flown), lambda rows: 2**16)
    if is_accepted:
        assert replies.read(by, tick, raw).refused.tolist() == [~uav for uav in uploads]
    else:
        with pytest.raises(MessageRejected, match=r"^wrong-shape.*refused names uploads to others"):
            replies.read(by, tick, raw)


@pytest.mark.parametrize("flown", [STATES, MODELS, BYTES], ids=["states", "models", "models in bytes"])
def test_a_damaged_reply_is_rejected_or_is_one_that_this_node_can_send(flown: Scenario) -> None:
    frames = broadcast(3, 4) if flown is STATES else upload(flown, 3, 4)
    good = wire.write_act(reply(flown, 3, 4, outbox=(frames,)))

    @QUICK
    @given(st.lists(st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)), min_size=1, max_size=3))
    def check(damage: list[tuple[int, int]]) -> None:
        raw = bytearray(good)
        for place, byte in damage:
            raw[place] = byte
        try:
            act = read(flown, bytes(raw), member(3, 4))
        except MessageRejected:
            return
        assert (act.run, act.tick, len(act.commands)) == (RUN, TICK, 2)
        assert wire.write_act(act) == bytes(raw)
        for batch in act.outbox:
            assert set(batch.source.tolist()) <= {3, 4}
            if batch.kind == FrameKind.UPLOAD:
                assert codings.of_uploads(flown).sound(batch.payload).all()
            else:
                assert np.isfinite(batch.payload).all()

    check()


# -- the frames of a tick -----------------------------------------------------------------------------------------


class Air:
    """A `FrameMerger` that notes what it drops and bills."""

    def __init__(self, flown: Scenario) -> None:
        self.dropped: list[str] = []
        self.meter = Meter(flown.radio, flown.uavs)
        self._merger = FrameMerger(Post(flown), lambda error, where: self.dropped.append(where))

    def merge(self, *batches: Frames, silent: tuple[int, ...] = (), tick: int = TICK) -> list[Frames]:
        active = np.ones(8, dtype=bool)
        active[list(silent)] = False
        return self._merger.merged(tick, batches, active, self.meter)

    @property
    def billed(self) -> int:
        return self.meter.traffic[FrameKind.UPLOAD].wire_bytes


def test_uploads_are_merged_into_one_batch_and_billed_by_their_bytes() -> None:
    air, batches = Air(ALL), [upload(ALL, uav) for uav in range(7)]
    (merged,) = air.merge(*batches)
    assert merged.source.tolist() == list(range(7))
    np.testing.assert_array_equal(merged.payload, np.concatenate([each.payload for each in batches]))
    assert (merged.kind, merged.round, merged.links) == (FrameKind.UPLOAD, 2, None)
    assert air.billed == sum(wire.bytes_of_batch(each) for each in batches)
    assert not air.dropped


def test_uploads_of_other_rounds_and_of_silent_uavs_are_left_out() -> None:
    air = Air(ALL)
    batches = [upload(ALL, 0), upload(ALL, 1, number=3), upload(ALL, 2, 3), upload(ALL, 4), upload(ALL, 5, number=1)]
    (merged,) = air.merge(*batches, silent=(3, 4))
    assert merged.source.tolist() == [0, 2]
    assert air.dropped == ["frames of UAV 1", "frames of UAV 5"]
    assert air.billed == sum(wire.bytes_of_batch(each) for each in (upload(ALL, 0), upload(ALL, 2)))
    assert Air(MODELS).merge(upload(MODELS, 1, number=7)) == []


def test_an_upload_of_a_uav_that_takes_no_part_in_the_round_is_dropped() -> None:
    half = MODELS.replace(**{"federation.fraction": 0.5})
    air = Air(half)
    (merged,) = air.merge(*[upload(half, uav) for uav in range(8)])
    assert merged.source.tolist() == Schedule(half).participants(2).tolist()
    assert len(air.dropped) == 4


def test_a_second_global_model_of_a_round_is_dropped() -> None:
    one, air = Frames(FrameKind.GLOBAL, 2, np.zeros(1, np.int32), np.ones((1, 246), np.float32)), Air(MODELS)
    (merged,) = air.merge(one, one, tick=TICK + 1)
    assert len(merged.source) == 1
    assert len(air.dropped) == 1


def test_the_order_of_frames_does_not_depend_on_processes_or_arrival() -> None:
    """Each frame draws its own fading, so the order is part of the flight."""
    frames = [broadcast(0, number=1), broadcast(1, dtype="u1"), broadcast(2), upload(ALL, 3)]
    frames += [broadcast(4, number=1), broadcast(5)]
    merged = []
    for order in ((0, 1, 2, 3, 4, 5), (5, 3, 1, 0, 2, 4), (4, 5, 3, 2, 1, 0)):
        batches = Air(ALL).merge(*[frames[k] for k in sorted(order[:3])], *[frames[k] for k in sorted(order[3:])])
        merged.append([(f.kind, f.round, f.payload.dtype.str, sorted(f.source.tolist())) for f in batches])
    assert merged[0] == merged[1] == merged[2]
    assert [kind for kind, *_ in merged[0]] == [FrameKind.UPLOAD] + 3 * [FrameKind.STATE]
