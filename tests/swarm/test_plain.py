"""Plain messages are the codec's, byte for byte; and nothing else is taken for one."""

import msgspec
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
    written = plain.senses(run, len(states), report).encode(tick, states)
    assert written == codec.encode(Sense(run, tick, states, report))


DTYPES = ["<f2", "<f4", "<f8", "u1"]


@st.composite
def batches(draw: st.DrawFn, kind: FrameKind, sources: int, *, links: int = 0) -> Frames:
    """Models of so many UAVs as they are transmitted."""
    dtype = np.dtype(draw(st.sampled_from(DTYPES)))
    payload = np.frombuffer(draw(st.binary(min_size=sources * 3 * dtype.itemsize)), "u1")
    payload = payload[: sources * 3 * dtype.itemsize].view(dtype).reshape(sources, 3)
    uavs = arrays(np.int32, sources, elements=st.integers(0, 2**31 - 1))
    to = draw(arrays(np.int32, (links, 2), elements=st.integers(-(2**31), 2**31 - 1))) if links else None
    return Frames(kind, draw(st.integers(0, 2**40)), draw(uavs), payload, to)


@QUICK
@given(st.data(), runs, ticks, rows, st.booleans())
def test_a_sense_that_brings_the_global_model_is_written_as_the_codec_does(
    data: st.DataObject, run: int, tick: int, count: int, report: bool
) -> None:
    brought = data.draw(batches(FrameKind.GLOBAL, 1, links=count))
    sense = Sense(run, tick, np.full((count, 4), 0.25), report, (brought,))
    assert plain.encode(sense) == codec.encode(sense)


@QUICK
@given(st.data(), runs, ticks, rows, st.booleans())
def test_an_upload_is_written_and_read_as_the_codec_does(
    data: st.DataObject, run: int, tick: int, count: int, reports: bool
) -> None:
    sent = data.draw(batches(FrameKind.UPLOAD, data.draw(st.integers(1, count))))
    outcome, report = np.full((count, 5), 0.25), np.full((count, 246), 0.5) if reports else None
    act = Act(run, tick, outcome, outbox=(sent,), report=report)
    kind = plain.uploads(run, count, reports, (sent.payload.shape, sent.payload.dtype))
    parts = [outcome, sent.source, sent.payload] + ([report] if report is not None else [])
    raw = kind.encode(tick, *parts, number=sent.round)
    assert raw == codec.encode(act)
    read = kind.decode(tick, raw, sent.round)
    if not np.isfinite(sent.payload).all():
        assert read is None
        return
    assert read is not None
    assert [part.tobytes() for part in read] == [part.tobytes() for part in parts]
    assert kind.decode(tick + 1, raw, sent.round) is None
    assert kind.decode(tick, raw, sent.round + 1) is None


@QUICK
@given(st.data(), runs, ticks, rows, st.booleans(), st.sets(st.integers(0, 3)))
def test_a_template_is_the_message_with_gaps(
    data: st.DataObject, run: int, tick: int, count: int, reports: bool, known: set[int]
) -> None:
    sent = data.draw(batches(FrameKind.UPLOAD, data.draw(st.integers(1, count))))
    kind = plain.uploads(run, count, reports, (sent.payload.shape, sent.payload.dtype))
    arrays_ = [np.full((count, 5), 0.25), sent.source, sent.payload, np.full((count, 246), 0.5)][: 3 + reports]
    gaps = [array.tobytes() if k in known else 10 + k for k, array in enumerate(arrays_)]
    template = kind.template(*gaps)
    texts, between = template[::2], template[1::2]
    assert all(isinstance(text, bytes) for text in texts)
    assert between == tuple(gap for gap in (plain.TICK, gaps[0], plain.NUMBER, *gaps[1:]) if isinstance(gap, int))
    number = msgspec.msgpack.encode
    fill = {plain.TICK: number(tick), plain.NUMBER: number(sent.round)} | {
        10 + k: array.tobytes() for k, array in enumerate(arrays_)
    }
    written = b"".join(part if isinstance(part, bytes) else fill[part] for part in template)
    assert written == kind.encode(tick, *arrays_, number=sent.round)


FRAMES = Frames(FrameKind.STATE, 0, np.zeros(1, np.int32), np.zeros((1, 4), np.float32), np.zeros((1, 2), np.int32))

_TO_ONE_OF_TWO = np.zeros(1, np.int32), np.ones((1, 5), np.float32), np.zeros((1, 2), np.int32)
_OF_TWO = np.arange(2, dtype=np.int32), np.ones((2, 5), np.float32), np.zeros((1, 2), np.int32)


def read(raw: bytes, tick: int = 300, run: int = RUN, rows: int = 2) -> Act | None:
    """A plain Act of so many rows, with a report or without, whichever this is; None where it is neither."""
    for report in (False, True):
        if (arrays_ := plain.acts(run, rows, report).decode(tick, raw)) is not None:
            return Act(run, tick, arrays_[0], report=arrays_[1] if report else None)
    return None


@pytest.mark.parametrize(
    "sense",
    [
        Sense(RUN, 7, np.ones((2, 4)), False, (FRAMES,)),
        Sense(RUN, 7, np.ones((2, 4)), False, (), True),
        Sense(RUN, 7, np.ones((0, 4)), False),
        Sense(RUN, 7, np.ones((2, 4)), False, (FRAMES, FRAMES)),
        Sense(RUN, 7, np.ones((2, 4)), False, (Frames(FrameKind.GLOBAL, 3, *_TO_ONE_OF_TWO),)),
        Sense(RUN, 7, np.ones((1, 4)), False, (Frames(FrameKind.GLOBAL, 3, *_OF_TWO),)),
        Sense(RUN, 7, np.ones((1, 4)), False, (Frames(FrameKind.UPLOAD, 3, *_TO_ONE_OF_TWO),), True),
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
    act = read(raw, tick, run, len(outcome))
    told = plain.acts(run, len(outcome), reports).split(tick, raw)
    assert plain.acts(run, len(outcome), not reports).split(tick, raw) is None
    if not (np.isfinite(outcome).all() and (report is None or np.isfinite(report).all())):
        assert act is told is None
        with pytest.raises(MessageRejected, match="array"):
            codec.decode(raw)
        return
    assert act is not None
    assert codec.encode(act) == raw
    assert act.outcome.shape == outcome.shape
    assert act.outcome.tobytes() == outcome.tobytes()
    assert not act.outcome.flags.writeable
    assert told == ((outcome.tobytes(),) if report is None else (outcome.tobytes(), report.tobytes()))
    assert (act.report is None) == (report is None)


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
    raw = codec.encode(OTHERS[what])
    assert read(raw) is None
    assert plain.acts(RUN, 2).split(300, raw) is plain.acts(RUN, 2, True).split(300, raw) is None


@QUICK
@given(st.data())
def test_damaged_bytes_are_not_plain_or_mean_what_the_codec_reads(data: st.DataObject) -> None:
    outcome = data.draw(arrays(np.float64, (2, 5), elements=finite))
    report = data.draw(st.sampled_from([None, np.full((2, 246), 0.5)]))
    raw = bytearray(codec.encode(Act(RUN, 300, outcome, report=report)))
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.sampled_from([bytes(raw), bytes(raw[:-1]), bytes(raw) + b"\xc0", bytes(raw[1:])]))
    act, told = read(cut), [plain.acts(RUN, 2, reports).split(300, cut) for reports in (False, True)]
    assert (act is None) == (told == [None, None])
    if act is not None:
        understood = codec.decode(cut)
        assert isinstance(understood, Act)
        assert codec.encode(act) == codec.encode(understood)
        parts = [part.tobytes() for part in (understood.outcome, understood.report) if part is not None]
        assert tuple(parts) in told
