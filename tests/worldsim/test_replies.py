"""The reply of a node: the world accepts its broadcasts, and merges the frames of all nodes.

Replies that it rejects: tests/faults/test_hostile_input.py.
"""

from typing import Any

import numpy as np

from meanflock.channel.meter import Meter
from meanflock.federation import coding as codings
from meanflock.federation.post import Post
from meanflock.swarm.declared import MAX_BROADCASTS
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import FrameMerger, Replies
from tests.swarm.examples import same

RUN, TICK = 0xC0FFEE42, 20
STATES = load(None, ["uavs=8"], method="hjb")
MODELS = load(None, ["uavs=8", "federation.period=10"], method="mfgfl-hf")
ALL = MODELS.replace(**{"federation.fraction": 1.0})
MOST = STATES.declared.broadcast_numbers  # of a UAV in a tick
INTEGERS = ("i1", "u1", "<i2", "<i4")


def broadcast(*uavs: int, dtype: Any = "<f4", width: int = 4, number: int = 0) -> Frames:
    payload = np.random.default_rng(len(uavs) + width).integers(0, 99, (len(uavs), width)).astype(dtype)
    return Frames(FrameKind.STATE, number, np.array(uavs, np.int32), payload)


def upload(flown: Scenario, *uavs: int, number: int = 2) -> Frames:
    coding = codings.of_uploads(flown)
    models = np.random.default_rng(uavs[0]).normal(size=(len(uavs), coding.floats))
    return Frames(FrameKind.UPLOAD, number, np.array(uavs, np.int32), coding.encode(models))


def test_broadcasts_of_any_width_and_type_of_some_rows_are_accepted() -> None:
    frames = [broadcast(3, 5, dtype=name, width=width, number=width) for width, name in enumerate(INTEGERS, 1)]
    frames += [broadcast(2, width=MOST), broadcast(2, 5, number=MAX_BROADCASTS - 1)]
    act = Act(RUN, TICK, np.full((3, 2 + len(STATES.declared.diagnostics)), 0.25), outbox=tuple(frames))
    replies = Replies(STATES, RUN, Post(STATES), lambda rows: 2**16)
    same(replies.read(Member("agent-2", "agent", np.array([2, 3, 5])), TICK, wire.write_act(act)), act)


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
