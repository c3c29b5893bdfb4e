"""Uploads on their way through the world: let in by few steps as by many, joined on the air, and billed to the byte."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.worldsim.sound import RUN, TICK, read

from channel.meter import Meter
from swarm import codec, payload
from swarm.errors import MessageRejected
from swarm.messages import Act, FrameKind, Frames
from swarm.rounds import Rounds
from swarm.scenario import Scenario, load
from worldsim import inbound
from worldsim.ledger import Ledger
from worldsim.members import Member
from worldsim.speech import Speech

QUICK = settings(max_examples=200, deadline=None, database=None)


def flown(*settings: str) -> Scenario:
    return load(None, ["uavs=8", "federation.period=10", *settings], method="mfgfl-hf")


def member(*uavs: int) -> Member:
    return Member(f"agent-{uavs[0]}", "agent", np.array(uavs))


def batch(of: Scenario, *uavs: int, number: int = 2) -> Frames:
    coding = payload.upload(of)
    models = np.random.default_rng(uavs[0]).normal(size=(len(uavs), coding.floats))
    return Frames(FrameKind.UPLOAD, number, np.array(uavs, np.int32), coding.encode(models))


def act(of: Scenario, *uavs: int, report: bool = False, number: int = 2, tick: int = TICK) -> Act:
    models = np.full((len(uavs), 246), 0.5) if report else None
    return Act(RUN, tick, np.full((len(uavs), 5), 0.25), outbox=(batch(of, *uavs, number=number),), report=models)


def checked(of: Scenario, raw: bytes, by: Member) -> Act:
    """The long way."""
    message = codec.decode(raw, inbound.limit(len(by.uavs), of))
    return inbound.check(message, RUN, TICK, by, of, np.dtype(np.float32))


@pytest.mark.parametrize("coding", ["float32", "float16", "int8"])
@pytest.mark.parametrize("report", [False, True])
def test_an_upload_is_let_in_as_the_long_way_does(coding: str, report: bool) -> None:
    of = flown(f"federation.payload={coding}")
    raw = codec.encode(act(of, 3, report=report))
    got = read(of, raw, member(3), report)
    assert got is not None
    assert codec.encode(got) == codec.encode(checked(of, raw, member(3))) == raw
    assert read(of, raw, member(3), not report) is None


def test_what_is_not_expected_takes_the_long_way() -> None:
    of = flown()
    others = [act(of, 4), act(of, 3, number=3), act(of, 3, tick=21), Act(RUN, TICK, np.zeros((2, 5)))]
    assert not any(read(of, codec.encode(other), member(3)) for other in others)
    assert read(of, codec.encode(act(of, 3, 4)), member(3, 4)) is None
    silent = read(of, codec.encode(Act(RUN, TICK, np.zeros((1, 5)))), member(3))  # takes no part in the round
    assert silent is not None
    assert not silent.outbox


@pytest.mark.parametrize("coding", ["float32", "int8"])
def test_a_damaged_upload_is_let_in_only_if_the_long_way_lets_it_in_and_says_the_same(coding: str) -> None:
    of = flown(f"federation.payload={coding}")
    good = codec.encode(act(of, 3))

    @QUICK
    @given(st.lists(st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)), min_size=1, max_size=3))
    def check(damage: list[tuple[int, int]]) -> None:
        raw = bytearray(good)
        for place, byte in damage:
            raw[place] = byte
        if (got := read(of, bytes(raw), member(3))) is not None:
            assert codec.encode(got) == codec.encode(checked(of, bytes(raw), member(3)))

    check()


def test_scales_beyond_all_bounds_are_for_the_long_way_to_refuse() -> None:
    of = flown("federation.payload=int8")
    wild = act(of, 3)
    wild.outbox[0].payload[0, -4:] = np.frombuffer(np.float32(np.inf).tobytes(), "u1")
    raw = codec.encode(wild)
    assert read(of, raw, member(3)) is None
    with pytest.raises(MessageRejected, match="scales"):
        checked(of, raw, member(3))


class Air:
    """Speech with what it drops, notes and bills kept."""

    def __init__(self, of: Scenario) -> None:
        self.dropped: list[str] = []
        self.ledger, self.meter = Ledger(), Meter(of.radio, of.uavs)
        self._speech = Speech(Rounds(of), self.ledger, lambda error, where: self.dropped.append(where), lambda *_: None)

    def say(self, *batches: Frames, asleep: tuple[int, ...] = (), tick: int = TICK) -> list[Frames]:
        awake = np.ones(8, dtype=bool)
        awake[list(asleep)] = False
        return self._speech.of(tick, batches, awake, self.meter)

    @property
    def billed(self) -> int:
        return self.meter.traffic[FrameKind.UPLOAD].wire_bytes


def test_uploads_go_on_the_air_as_one_batch_and_cost_what_they_are_on_the_bus() -> None:
    of = flown("federation.fraction=1.0")
    air, batches = Air(of), [batch(of, uav) for uav in range(7)]
    (said,) = air.say(*batches)
    assert said.source.tolist() == list(range(7))
    np.testing.assert_array_equal(said.payload, np.concatenate([each.payload for each in batches]))
    assert (said.kind, said.round, said.links) == (FrameKind.UPLOAD, 2, None)
    assert air.billed == sum(len(codec.encode_frames(each)) for each in batches)
    assert not air.dropped


def test_of_uploads_only_the_stray_and_the_silent_are_left_out() -> None:
    of = flown("federation.fraction=1.0")
    air = Air(of)
    batches = [batch(of, 0), batch(of, 1, number=3), batch(of, 2, 3), batch(of, 4), batch(of, 5, number=1)]
    (said,) = air.say(*batches, asleep=(3, 4))
    assert said.source.tolist() == [0, 2]
    assert air.dropped == ["frames of UAV 1", "frames of UAV 5"]
    assert air.billed == sum(len(codec.encode_frames(each)) for each in (batch(of, 0), batch(of, 2)))


def test_who_takes_no_part_in_a_round_is_not_heard() -> None:
    of = flown("federation.fraction=0.5")
    taking = Counter(Rounds(of).participants(2).tolist())
    air = Air(of)
    (said,) = air.say(*[batch(of, uav) for uav in range(8)])
    assert said.source.tolist() == sorted(taking)
    assert len(air.dropped) == 4


def test_a_second_global_model_of_a_round_is_not_broadcast() -> None:
    of = flown()
    one = Frames(FrameKind.GLOBAL, 2, np.zeros(1, np.int32), np.ones((1, 246), np.float32))
    air = Air(of)
    (said,) = air.say(one, one, tick=TICK + 1)
    assert len(said.source) == 1
    assert air.ledger.rounds == 1
    assert len(air.dropped) == 1


def test_where_nobody_is_heard_nothing_goes_on_the_air() -> None:
    assert Air(flown()).say(batch(flown(), 1, number=7)) == []
