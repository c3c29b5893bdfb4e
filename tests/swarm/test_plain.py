"""Plain messages are the codec's, byte for byte; and nothing else is taken for one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from swarm import codec, plain
from swarm.errors import MessageRejected
from swarm.messages import Act, FrameKind, Frames, Message, Sense

QUICK = settings(max_examples=200, deadline=None, database=None)
RUN = 0xC0FFEE42

ticks = st.integers(0, 2**40)  # the width of a whole number in msgpack grows with it
runs = st.integers(0, 2**32 - 1)
rows = st.integers(1, 30)
floats = st.floats(width=64)
finite = st.floats(width=64, allow_nan=False, allow_infinity=False)


@QUICK
@given(runs, ticks, rows.flatmap(lambda m: arrays(np.float64, (m, 4), elements=floats)), st.booleans())
def test_a_plain_sense_is_written_as_the_codec_does(run: int, tick: int, states: np.ndarray, report: bool) -> None:
    sense = Sense(run, tick, states, report)
    assert plain.encode(sense) == codec.encode(sense)


FRAMES = Frames(FrameKind.STATE, 0, np.zeros(1, np.int32), np.zeros((1, 4), np.float32), np.zeros((1, 2), np.int32))


@pytest.mark.parametrize(
    "sense",
    [
        Sense(RUN, 7, np.ones((2, 4)), False, (FRAMES,)),
        Sense(RUN, 7, np.ones((2, 4)), False, (), True),
        Sense(RUN, 7, np.ones((0, 4)), False),
    ],
)
def test_a_sense_that_is_not_plain_is_written_as_well(sense: Sense) -> None:
    assert plain.encode(sense) == codec.encode(sense)


@QUICK
@given(runs, ticks, rows.flatmap(lambda m: arrays(np.float64, (m, 5), elements=floats)), st.booleans(), floats)
def test_a_plain_act_is_read_as_the_codec_does(
    run: int, tick: int, outcome: np.ndarray, reports: bool, weight: float
) -> None:
    report = np.full((len(outcome), 246), 0.5) if reports else None
    if report is not None:
        report[-1, -1] = weight
    raw = codec.encode(Act(run, tick, outcome, report=report))
    read = plain.decode(raw, run, tick, len(outcome))
    if not (np.isfinite(outcome).all() and (report is None or np.isfinite(report).all())):
        assert read is None
        with pytest.raises(MessageRejected, match="array"):
            codec.decode(raw)
        return
    assert read is not None
    assert codec.encode(read) == raw
    assert read.outcome.shape == outcome.shape
    assert read.outcome.tobytes() == outcome.tobytes()
    assert not read.outcome.flags.writeable
    assert (read.report is None) == (report is None)


OTHERS: dict[str, Message] = {
    "another run": Act(RUN + 1, 300, np.ones((2, 5))),
    "another tick": Act(RUN, 301, np.ones((2, 5))),
    "a tick of another width": Act(RUN, 3, np.ones((2, 5))),
    "other rows": Act(RUN, 300, np.ones((3, 5))),
    "other columns": Act(RUN, 300, np.ones((2, 4))),
    "floats of half the width": Act(RUN, 300, np.ones((4, 5), dtype=np.float32)),
    "one who has diverged": Act(RUN, 300, np.ones((2, 5)), (1,)),
    "an outbox": Act(RUN, 300, np.ones((2, 5)), outbox=(FRAMES,)),
    "a report of other models": Act(RUN, 300, np.ones((2, 5)), report=np.ones((2, 245))),
    "residuals": Act(RUN, 300, np.ones((2, 5)), report=np.ones((2, 246)), residuals=np.ones((2, 246))),
    "a sense": Sense(RUN, 300, np.ones((2, 5)), False),
}


@pytest.mark.parametrize("what", OTHERS)
def test_what_says_more_or_something_else_is_not_plain(what: str) -> None:
    assert plain.decode(codec.encode(OTHERS[what]), RUN, 300, 2) is None


def test_a_node_without_uavs_says_nothing_plain() -> None:
    assert plain.decode(codec.encode(Act(RUN, 300, np.ones((0, 5)))), RUN, 300, 0) is None


@QUICK
@given(st.data())
def test_damaged_bytes_are_not_plain_or_mean_what_the_codec_reads(data: st.DataObject) -> None:
    outcome = data.draw(arrays(np.float64, (2, 5), elements=finite))
    raw = bytearray(codec.encode(Act(RUN, 300, outcome)))
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.sampled_from([bytes(raw), bytes(raw[:-1]), bytes(raw) + b"\xc0", bytes(raw[1:])]))
    read = plain.decode(cut, RUN, 300, 2)
    if read is not None:
        understood = codec.decode(cut)
        assert isinstance(understood, Act)
        assert codec.encode(read) == codec.encode(understood)
