"""What controllers broadcast: any number, width and type of frames that a radio carries, and nothing else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.federation.post import Post
from meanflock.swarm.declared import MAX_BROADCASTS
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import Replies
from tests.swarm.examples import same

RUN, TICK = 0xC0FFEE42, 20
QUICK = settings(max_examples=300, deadline=None, database=None)
FLOAT = FLOAT_OF_BITS[32]
INTEGERS = ("i1", "u1", "<i2", "<i4")
MOST = load(None, method="hjb").declared.broadcast_numbers  # a row broadcasts in a tick
LEADER = Member("leader", "leader", np.zeros(0, np.intp))


def flown(bits: int = 32, method: str = "hjb") -> Scenario:
    return load(None, ["uavs=8", f"radio.bits_per_float={bits}"], method=method)


def member(*uavs: int) -> Member:
    return Member(f"agent-{uavs[0]}", "agent", np.array(uavs))


def batch(*uavs: int, dtype: np.dtype | str = FLOAT, width: int = 4, number: int = 0) -> Frames:
    said = np.random.default_rng(len(uavs) + width).integers(0, 99, (len(uavs), width)).astype(dtype)
    return Frames(FrameKind.STATE, number, np.array(uavs, np.int32), said)


def act(*uavs: int, outbox: tuple[Frames, ...] | None = None, report: bool = False) -> Act:
    models = np.full((len(uavs), 246), 0.5) if report else None
    said = (batch(*uavs),) if outbox is None else outbox
    return Act(RUN, TICK, np.full((len(uavs), 4), 0.25), outbox=said, models=models)


def read(raw: bytes, by: Member, bits: int = 32, method: str = "hjb") -> Act:
    return Replies(flown(bits, method), RUN, Post(flown(bits, method)), lambda rows: 2**16).read(by, TICK, raw)


@pytest.mark.parametrize("bits", [16, 32, 64])
@pytest.mark.parametrize("report", [False, True])
@pytest.mark.parametrize("uavs", [(3,), (2, 3, 5), tuple(range(8))])
def test_states_are_let_in_as_they_were_written(bits: int, report: bool, uavs: tuple[int, ...]) -> None:
    given_ = act(*uavs, outbox=(batch(*uavs, dtype=FLOAT_OF_BITS[bits]),), report=report)
    same(read(tick.write_act(given_), member(*uavs), bits), given_)


def test_several_frames_of_any_width_and_type_from_some_of_the_rows_are_let_in() -> None:
    words = [batch(3, 5, dtype=name, width=width, number=width) for width, name in enumerate(INTEGERS, 1)]
    words += [batch(2, width=MOST), batch(2, 5, number=MAX_BROADCASTS - 1)]
    given_ = act(2, 3, 5, outbox=tuple(words))
    same(read(tick.write_act(given_), member(2, 3, 5)), given_)
    silent = act(2, 3, 5, outbox=())
    same(read(tick.write_act(silent), member(2, 3, 5)), silent)


def of_kind(kind: FrameKind, width: int) -> Frames:
    return Frames(kind, 1, np.array([3], "<i4"), np.zeros((1, width), FLOAT))


REFUSED = {
    "a UAV of another node": ((batch(4),), "wrong-shape"),
    "a UAV there is not": ((batch(8),), "wrong-shape"),
    "a negative UAV": ((batch(-1),), "wrong-shape"),
    "one twice": ((batch(3, 3),), "wrong-shape"),
    "descending": ((batch(5, 3),), "wrong-shape"),
    "of nobody": ((batch(),), "wrong-shape"),
    "of no numbers": ((batch(3, width=0),), "wrong-shape"),
    "too wide": ((batch(3, width=MOST + 1),), "wrong-shape"),
    "too many": ((batch(3, number=MAX_BROADCASTS),), "wrong-shape"),
    "a number twice": ((batch(3), batch(5)), "wrong-shape"),
    "wider floats than the radio's": ((batch(3, dtype="<f8"),), "wrong-shape"),
    "narrower floats": ((batch(3, dtype="<f2"),), "wrong-shape"),
    "an upload without rounds": (
        (Frames(FrameKind.UPLOAD, 1, np.array([3], "<i4"), np.zeros((1, 246), FLOAT)),),
        "wrong-kind",
    ),
    "a global model": ((Frames(FrameKind.GLOBAL, 1, np.array([3], "<i4"), np.zeros((1, 246), FLOAT)),), "wrong-kind"),
    "a relay": ((Frames(FrameKind.RELAY, 1, np.array([3], "<i4"), np.zeros((1, 247), FLOAT)),), "wrong-kind"),
    "with links": (
        (Frames(FrameKind.STATE, 0, np.array([3], "<i4"), np.zeros((1, 4), FLOAT), np.zeros((1, 2), "<i4")),),
        "wrong-shape",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_a_node_cannot_broadcast_is_refused(what: str) -> None:
    outbox, reason = REFUSED[what]
    with pytest.raises(MessageRejected) as caught:
        read(tick.write_act(act(2, 3, 5, outbox=outbox)), member(2, 3, 5))
    assert caught.value.reason == reason


def test_a_leader_broadcasts_no_states() -> None:
    with pytest.raises(MessageRejected, match="wrong-kind"):
        read(tick.write_act(Act(RUN, TICK, np.zeros((0, 2)), outbox=(batch(0),))), LEADER)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["commands", "states", "report"])
def test_what_is_not_finite_is_refused(number: float, where: str) -> None:
    wild = act(3, 4, report=True)
    assert wild.models is not None
    {"commands": wild.commands, "states": wild.outbox[0].payload, "report": wild.models}[where][1, 2] = number
    with pytest.raises(MessageRejected, match="non-finite"):
        read(tick.write_act(wild), member(3, 4))


@pytest.mark.parametrize("refused", [[8], [-1], [3, 3], [2**31 - 1]], ids=["nobody", "negative", "twice", "far beyond"])
def test_refused_names_uavs_there_are_and_each_once(refused: list[int]) -> None:
    good = Act(RUN, TICK, np.zeros((1, 4)), refused=np.array([0, 7]))
    assert read(tick.write_act(good), member(3)).refused.tolist() == [0, 7]
    with pytest.raises(MessageRejected, match="wrong-shape"):
        read(tick.write_act(Act(RUN, TICK, np.zeros((1, 4)), refused=np.array(refused))), member(3))


@pytest.mark.parametrize("uavs", [(3,), (3, 4)])
def test_damaged_bytes_are_let_in_only_as_what_this_node_can_say_in_this_tick(uavs: tuple[int, ...]) -> None:
    good = tick.write_act(act(*uavs))

    @QUICK
    @given(st.lists(st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)), min_size=1, max_size=3))
    def check(damage: list[tuple[int, int]]) -> None:
        raw = bytearray(good)
        for place, byte in damage:
            raw[place] = byte
        try:
            got = read(bytes(raw), member(*uavs))
        except MessageRejected:
            return
        assert (got.run, got.tick, got.commands.shape) == (RUN, TICK, (len(uavs), 4))
        assert tick.write_act(got) == bytes(raw)
        for said in got.outbox:
            assert set(said.source.tolist()) <= set(uavs)
            assert np.isfinite(said.payload).all()

    check()


@QUICK
@given(st.binary(max_size=300))
def test_bytes_of_whatever_kind_are_not_let_in(raw: bytes) -> None:
    good = tick.write_act(act(3))
    for bad in (raw, good + raw + b"\0", good[: len(raw)][:-1]):
        with pytest.raises(MessageRejected):
            read(bad, member(3))
