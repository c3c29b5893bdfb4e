"""Uploads on their way through the world: let in if they can be, joined on the air, and billed to the byte."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.channel.meter import Meter
from meanflock.federation import coding as codings
from meanflock.federation.post import Post
from meanflock.federation.schedule import Schedule
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import FrameMerger, Replies
from tests.swarm.examples import same

RUN, TICK = 0xC0FFEE42, 20
QUICK = settings(max_examples=200, deadline=None, database=None)


def flown(*settings: str) -> Scenario:
    return load(None, ["uavs=8", "federation.period=10", *settings], method="mfgfl-hf")


def member(*uavs: int) -> Member:
    return Member(f"agent-{uavs[0]}", "agent", np.array(uavs))


def batch(of: Scenario, *uavs: int, number: int = 2) -> Frames:
    coding = codings.of_uploads(of)
    models = np.random.default_rng(uavs[0]).normal(size=(len(uavs), coding.floats))
    return Frames(FrameKind.UPLOAD, number, np.array(uavs, np.int32), coding.encode(models))


def act(of: Scenario, *uavs: int, report: bool = False, number: int = 2, tick: int = TICK) -> Act:
    models = np.full((len(uavs), 246), 0.5) if report else None
    return Act(RUN, tick, np.full((len(uavs), 5), 0.25), outbox=(batch(of, *uavs, number=number),), models=models)


def read(of: Scenario, raw: bytes, by: Member) -> Act:
    return Replies(of, RUN, Post(of), lambda rows: 2**16).read(by, TICK, raw)


@pytest.mark.parametrize("coding", ["float32", "float16", "int8"])
@pytest.mark.parametrize("report", [False, True])
def test_an_upload_is_let_in_as_it_was_written(coding: str, report: bool) -> None:
    of = flown(f"federation.payload={coding}")
    for uavs in ((3,), (3, 4)):
        given_ = act(of, *uavs, report=report)
        same(read(of, wire.write_act(given_), member(*uavs)), given_)
    silent = Act(RUN, TICK, np.zeros((1, 5)))  # takes no part in the round
    same(read(of, wire.write_act(silent), member(3)), silent)


def test_what_is_of_another_uav_tick_or_form_is_refused() -> None:
    of = flown()
    others = {
        "another UAV's": (act(of, 4), "wrong-shape"),
        "of another tick": (act(of, 3, tick=21), "stale"),
        "of two rows": (Act(RUN, TICK, np.zeros((2, 5))), "wrong-shape"),
        "in bytes": (act(flown("federation.payload=int8"), 3), "wrong-shape"),
        "of another method": (act(load(None, ["uavs=8"], method="mfgfl-h"), 3), "wrong-shape"),
        "twice": (Act(RUN, TICK, np.zeros((1, 5)), outbox=(batch(of, 3), batch(of, 3, number=3))), "wrong-shape"),
    }
    for what, (other, reason) in others.items():
        with pytest.raises(MessageRejected) as caught:
            read(of, wire.write_act(other), member(3))
        assert caught.value.reason == reason, what


@pytest.mark.parametrize("coding", ["float32", "int8"])
def test_a_damaged_upload_is_let_in_only_as_one_that_can_be(coding: str) -> None:
    of = flown(f"federation.payload={coding}")
    good = wire.write_act(act(of, 3))

    @QUICK
    @given(st.lists(st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)), min_size=1, max_size=3))
    def check(damage: list[tuple[int, int]]) -> None:
        raw = bytearray(good)
        for place, byte in damage:
            raw[place] = byte
        try:
            got = read(of, bytes(raw), member(3))
        except MessageRejected:
            return
        assert wire.write_act(got) == bytes(raw)
        for said in got.outbox:
            if said.kind == FrameKind.UPLOAD:
                assert codings.of_uploads(of).sound(said.payload).all()

    check()


def test_scales_beyond_all_bounds_are_refused() -> None:
    of = flown("federation.payload=int8")
    wild = act(of, 3)
    wild.outbox[0].payload[0, -4:] = np.frombuffer(np.float32(np.inf).tobytes(), "u1")
    with pytest.raises(MessageRejected, match="scales"):
        read(of, wire.write_act(wild), member(3))


class Air:
    """FrameMerger with what it drops, notes and bills kept."""

    def __init__(self, of: Scenario) -> None:
        self.dropped: list[str] = []
        self.meter = Meter(of.radio, of.uavs)
        self._merger = FrameMerger(Post(of), lambda error, where: self.dropped.append(where))

    def say(self, *batches: Frames, asleep: tuple[int, ...] = (), tick: int = TICK) -> list[Frames]:
        awake = np.ones(8, dtype=bool)
        awake[list(asleep)] = False
        return self._merger.merged(tick, batches, awake, self.meter)

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
    assert air.billed == sum(wire.bytes_of_batch(each) for each in batches)
    assert not air.dropped


def test_of_uploads_only_the_stray_and_the_silent_are_left_out() -> None:
    of = flown("federation.fraction=1.0")
    air = Air(of)
    batches = [batch(of, 0), batch(of, 1, number=3), batch(of, 2, 3), batch(of, 4), batch(of, 5, number=1)]
    (said,) = air.say(*batches, asleep=(3, 4))
    assert said.source.tolist() == [0, 2]
    assert air.dropped == ["frames of UAV 1", "frames of UAV 5"]
    assert air.billed == sum(wire.bytes_of_batch(each) for each in (batch(of, 0), batch(of, 2)))


def test_who_takes_no_part_in_a_round_is_not_heard() -> None:
    of = flown("federation.fraction=0.5")
    taking = Counter(Schedule(of).participants(2).tolist())
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
    assert len(air.dropped) == 1


def test_where_nobody_is_heard_nothing_goes_on_the_air() -> None:
    assert Air(flown()).say(batch(flown(), 1, number=7)) == []


def of_state(number: int, *uavs: int, dtype: str = "<f4", width: int = 4) -> Frames:
    return Frames(FrameKind.STATE, number, np.array(uavs, np.int32), np.zeros((len(uavs), width), dtype))


def test_frames_go_on_the_air_in_the_same_order_whoever_is_in_which_process_and_speaks_first() -> None:
    """Each draws its own fading, so their order is part of the flight."""
    of = flown("federation.fraction=1.0")
    words = [of_state(1, 0), of_state(0, 1, dtype="u1"), of_state(0, 2), batch(of, 3), of_state(1, 4), of_state(0, 5)]
    heard = []
    for order in ((0, 1, 2, 3, 4, 5), (5, 3, 1, 0, 2, 4), (4, 5, 3, 2, 1, 0)):
        said = Air(of).say(*[words[k] for k in sorted(order[:3])], *[words[k] for k in sorted(order[3:])])
        heard.append([(f.kind, f.round, f.payload.dtype.str, sorted(f.source.tolist())) for f in said])
    assert heard[0] == heard[1] == heard[2]
    assert [kind for kind, *_ in heard[0]] == [FrameKind.UPLOAD] + 3 * [FrameKind.STATE]
