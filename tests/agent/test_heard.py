"""States heard by radio end where they belong, whether or not the links are those of the last time."""

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.heard import Heard
from swarm.messages import FrameKind, Frames

EVERYONE = 5


@st.composite
def batches(draw: st.DrawFn) -> tuple[np.ndarray, list[Frames]]:
    """The UAVs of a node, and what they hear tick by tick: mostly all, sometimes the same as before."""
    uavs = np.array(draw(st.lists(st.integers(0, EVERYONE - 1), min_size=1, unique=True).map(sorted)), dtype=np.intp)
    heard: list[Any] = []
    for number in range(draw(st.integers(1, 4))):
        if heard and draw(st.booleans()):
            source, links = heard[-1].source, heard[-1].links
        else:
            source = np.array(draw(st.permutations(range(EVERYONE)) | st.just(list(range(EVERYONE)))), dtype=np.int32)
            source = source[: draw(st.integers(1, EVERYONE) | st.just(EVERYONE))]
            every = [[row, uav] for row in range(len(source)) for uav in uavs if source[row] != uav]
            some = st.lists(st.sampled_from(every), unique_by=tuple) if every else st.just([])
            links = np.array(draw(some | st.just(every)), dtype=np.int32).reshape(-1, 2)
        payload = np.random.default_rng(number).normal(size=(len(source), 4)).astype(np.float32)
        heard.append(Frames(FrameKind.STATE, 0, source, payload, links))
    return uavs, heard


@settings(deadline=None)
@given(batches())
def test_every_row_knows_what_it_heard_last_and_of_itself_what_it_knew(case: tuple[np.ndarray, list[Frames]]) -> None:
    uavs, heard = case
    known = np.random.default_rng(99).normal(size=(len(uavs), EVERYONE, 4))
    expected, memory = known.copy(), Heard(uavs, EVERYONE)
    for frames in heard:
        assert frames.links is not None
        for row, uav in frames.links.tolist():
            expected[uavs.tolist().index(uav), frames.source[row]] = frames.payload[row]
        memory.take_in(frames, known)
        np.testing.assert_array_equal(known, expected)
        assert memory.again(frames)
        assert not memory.again(Frames(frames.kind, 0, frames.source + 1, frames.payload, frames.links))
        fewer = Frames(frames.kind, 0, frames.source, frames.payload, frames.links[:-1])
        assert memory.again(fewer) == (not len(frames.links))
