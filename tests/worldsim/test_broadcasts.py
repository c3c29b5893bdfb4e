"""States that a node says: let in by their bytes as by the long way, and by no other bytes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.worldsim.sound import RUN, TICK

from swarm import codec
from swarm.codec import FLOAT_OF_BITS
from swarm.errors import MessageRejected
from swarm.messages import Act, FrameKind, Frames
from swarm.scenario import Scenario, load
from tests.worldsim import sound
from worldsim import inbound
from worldsim.members import Member

QUICK = settings(max_examples=200, deadline=None, database=None)
FLOAT = FLOAT_OF_BITS[32]


def flown(bits: int = 32) -> Scenario:
    return load(None, ["uavs=8", f"radio.bits_per_float={bits}"], method="hjb")


def member(*uavs: int) -> Member:
    return Member(f"agent-{uavs[0]}", "agent", np.array(uavs))


def act(
    *uavs: int,
    float_: np.dtype = FLOAT,
    report: bool = False,
    tick: int = TICK,
    run: int = RUN,
    kind: FrameKind = FrameKind.STATE,
    number: int = 0,
    diverged: tuple[int, ...] = (),
) -> Act:
    said = np.random.default_rng(uavs[0]).normal(size=(len(uavs), 4)).astype(float_)
    models = np.full((len(uavs), 246), 0.5) if report else None
    outbox = (Frames(kind, number, np.array(uavs, np.int32), said),)
    return Act(run, tick, np.full((len(uavs), 5), 0.25), diverged=diverged, outbox=outbox, report=models)


def read(raw: bytes, by: Member, bits: int = 32, report: bool = False) -> Act | None:
    return sound.read(flown(bits), raw, by, report)


def checked(raw: bytes, by: Member, bits: int = 32) -> Act:
    """The long way."""
    of = flown(bits)
    message = codec.decode(raw, inbound.limit(len(by.uavs), of))
    return inbound.check(message, RUN, TICK, by, of, FLOAT_OF_BITS[bits])


@pytest.mark.parametrize("bits", [16, 32, 64])
@pytest.mark.parametrize("report", [False, True])
@pytest.mark.parametrize("uavs", [(3,), (2, 3, 5), tuple(range(8))])
def test_states_are_let_in_as_the_long_way_does(bits: int, report: bool, uavs: tuple[int, ...]) -> None:
    float_ = FLOAT_OF_BITS[bits]
    raw = codec.encode(act(*uavs, float_=float_, report=report))
    got = read(raw, member(*uavs), bits, report)
    assert got is not None
    assert codec.encode(got) == codec.encode(checked(raw, member(*uavs), bits)) == raw
    assert read(raw, member(*uavs), bits, not report) is None


def test_what_is_not_expected_takes_the_long_way() -> None:
    by = member(3, 4)
    both = act(3, 4)
    one_speaks = Act(RUN, TICK, both.outcome, outbox=act(3).outbox)  # which may be
    others = [
        one_speaks,
        act(3),
        act(3, 5),
        act(4, 3),
        act(3, 4, tick=TICK + 1),
        act(3, 4, run=RUN + 1),
        act(3, 4, kind=FrameKind.UPLOAD),
        act(3, 4, number=1),
        act(3, 4, diverged=(3,)),
        act(3, 4, float_=FLOAT_OF_BITS[64]),
        Act(RUN, TICK, np.zeros((3, 5))),
    ]
    assert read(codec.encode(both), by) is not None
    assert not any(read(codec.encode(other), by) for other in others)
    assert checked(codec.encode(one_speaks), by).outbox[0].source.tolist() == [3]
    silent = read(codec.encode(Act(RUN, TICK, both.outcome)), by)
    assert silent is not None
    assert not silent.outbox
    assert read(codec.encode(act(3)), Member("leader", "leader", np.zeros(0, np.intp))) is None


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["outcome", "states", "report"])
def test_what_is_not_finite_is_for_the_long_way_to_refuse(number: float, where: str) -> None:
    wild = act(3, 4, report=True)
    assert wild.report is not None
    {"outcome": wild.outcome, "states": wild.outbox[0].payload, "report": wild.report}[where][1, 2] = number
    raw = codec.encode(wild)
    assert read(raw, member(3, 4), report=True) is None
    with pytest.raises(MessageRejected, match="array"):
        checked(raw, member(3, 4))


@pytest.mark.parametrize("uavs", [(3,), (3, 4)])
def test_damaged_states_are_let_in_only_if_the_long_way_lets_them_in_and_says_the_same(uavs: tuple[int, ...]) -> None:
    good = codec.encode(act(*uavs))

    @QUICK
    @given(st.lists(st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)), min_size=1, max_size=3))
    def check(damage: list[tuple[int, int]]) -> None:
        raw = bytearray(good)
        for place, byte in damage:
            raw[place] = byte
        if (got := read(bytes(raw), member(*uavs))) is not None:
            assert codec.encode(got) == codec.encode(checked(bytes(raw), member(*uavs)))

    check()


@QUICK
@given(st.binary(max_size=300))
def test_bytes_of_whatever_kind_are_not_let_in(raw: bytes) -> None:
    good = codec.encode(act(3))
    by = member(3)
    assert all(read(bad, by) is None for bad in (raw, good + raw + b"\0", good[: len(raw)][:-1]))
