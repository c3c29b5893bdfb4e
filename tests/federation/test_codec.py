"""Models as bytes and back, in every coding: fragments, heads and weights, hostile bytes, bounds and rounding."""

import contextlib
import struct
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import meanflock as mf
from meanflock.agent.node import Agent
from meanflock.federation.codec import HEAD_BYTES, Codec, Coded, Cut, based_of, notes_of
from meanflock.federation.codings.base import COARSEST, FINEST
from meanflock.federation.codings.int8 import STEPS
from meanflock.federation.cut import coding_of
from meanflock.federation.memory import Feedback
from meanflock.federation.plan import plan_of
from meanflock.net import tick as wire
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.agent import nodes
from tests.federation.plugins import QSGD, SignSGD
from tests.methods import FEDERATED, PARTS

QUICK = settings(max_examples=100, deadline=None, database=None)
H, HF = PARTS["mfgfl-h"], PARTS["mfgfl-hf"]
CODINGS = (*plugins.names("coding"), QSGD.name, SignSGD.name)


@pytest.fixture(autouse=True)
def _registered() -> None:
    for coding in (QSGD, SignSGD):
        mf.register(coding)


def codec_of(name: str, parts: tuple[int, ...], cut: Cut | None = None, **form: Any) -> Codec:
    return Codec(coding_of(Scenario(), name), parts, cut, **form)


def encoded(codec: Codec, models: np.ndarray) -> Coded:
    return codec.encode(models, np.arange(len(models)), 1)


def rows_of(codec: Codec, models: np.ndarray) -> np.ndarray:
    return codec.rows(encoded(codec, models), np.ones((len(models), 1)))


# -- every coding -------------------------------------------------------------------------------------------------


@st.composite
def forms(draw: st.DrawFn) -> tuple[tuple[int, ...], Cut | None, dict[str, Any]]:
    """Parts of a model, its cut, and what a fragment has beside the numbers."""
    parts = draw(st.lists(st.integers(1, 40), min_size=1, max_size=6))
    head = draw(st.sampled_from([0, HEAD_BYTES, HEAD_BYTES + 5]))
    size = 8 * draw(st.integers(head + 1, 30))  # eight fill whole bytes in any coding, and the head fits
    most = np.full(3, 9) if draw(st.booleans()) else None
    cut = Cut(1, size, 3) if draw(st.booleans()) else None
    return tuple(parts), cut, {"weighted": draw(st.booleans()), "head": head, "most": most}


def written(codec: Codec, seed: int) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Three models of random numbers, their fragments, and what these have beside the numbers."""
    draw = np.random.default_rng(seed)
    models = draw.normal(size=(3, codec.floats))
    behind = draw.integers(1, 9, (3, codec.count)).astype(float) if codec.form.counted else np.ones((3, codec.count))
    weights = draw.integers(1, 99, (3, codec.count)) * behind if codec.form.weighted else behind
    beside = {"weights": weights, "behind": behind, "based": draw.integers(0, 2**32, 3), "notes": [b"", b"", b""]}
    if codec.note > 0:
        beside["notes"] = [b"", bytes(codec.note), b"\xff" * (codec.note - 1)]
    heads = codec.heads(beside["based"], beside["notes"])
    return models, codec.rows(encoded(codec, models), weights, behind, heads), beside


@pytest.mark.parametrize("name", CODINGS)
@settings(QUICK, max_examples=40)
@given(form=forms(), seed=st.integers(0, 99))
def test_fragments_of_a_model_are_the_model_with_all_that_it_carries(name: str, form: Any, seed: int) -> None:
    parts, cut, more = form
    codec = codec_of(name, parts, cut, **more)
    models, rows, beside = written(codec, seed)
    assert (rows.shape, rows.dtype, codec.bits) == ((3 * codec.count, codec.width), codec.dtype, 8 * rows[0].nbytes)
    assert codec.count == -(-(codec.form.head_numbers + sum(parts)) // codec.size)
    assert codec.ticks == (1 if cut is None else -(-codec.count // 3))
    source = np.arange(3).repeat(codec.count)
    codec.check(source, rows)
    pieces = codec.read(rows)
    coded = encoded(codec, models)
    assert codec.valid(coded).all()
    meant = codec.decode(coded)
    np.testing.assert_array_equal(codec.model(pieces.values.reshape(3, codec.count, -1)), meant)
    np.testing.assert_array_equal(pieces.behind.reshape(3, -1), beside["behind"])
    np.testing.assert_array_equal(pieces.weights.reshape(3, -1), beside["weights"])
    if more["head"]:
        first = pieces.heads[pieces.places == 0]
        assert based_of(first).tolist() == beside["based"].tolist()
        assert list(notes_of(first)) == beside["notes"]
        assert not pieces.heads[pieces.places > 0].any()
    for row in (0, len(rows) - 1):  # each is read without the others, and each model is written without the others
        alone = codec.read(rows[row : row + 1])
        for one, every in zip(alone, pieces, strict=True):
            np.testing.assert_array_equal(one[0], every[row])
    single = codec.encode(models[1:2], np.array([1]), 1)
    np.testing.assert_array_equal(codec.decode(single)[0], meant[1])


@pytest.mark.parametrize("name", CODINGS)
@settings(QUICK, max_examples=60)
@given(form=forms(), data=st.data())
def test_hostile_bytes_are_rejected_or_are_a_model_within_all_bounds(name: str, form: Any, data: st.DataObject) -> None:
    parts, cut, more = form
    codec = codec_of(name, parts, cut, **more)
    _, rows, _ = written(codec, 1)
    raw = bytearray(rows.tobytes())
    at = data.draw(st.integers(0, len(raw) - 1))
    false = data.draw(st.binary(min_size=1, max_size=12) | st.sampled_from([b"\xff" * 8, b"\0" * 8, b"\x80" * 4]))
    raw[at : at + len(false)] = false[: len(raw) - at]
    rows = np.frombuffer(bytes(raw), codec.dtype).reshape(rows.shape)
    try:
        codec.check(np.arange(3).repeat(codec.count), rows)
    except MessageRejected:
        return
    pieces = codec.read(rows)
    assert np.isfinite(pieces.values).all()
    assert coding_of(Scenario(), name).floats or (np.abs(pieces.values) <= STEPS * COARSEST).all()
    assert pieces.places.tolist() == list(range(codec.count)) * 3
    assert ((pieces.behind >= 1.0) & (pieces.behind <= (9 if more["most"] is not None else 1))).all()
    assert ((pieces.weights > 0.0) & (pieces.weights < COARSEST * 9)).all()
    assert all(len(note) <= max(0, codec.note) for note in notes_of(pieces.heads))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CODINGS)
def test_a_nan_that_signals_is_rejected_without_a_warning(name: str) -> None:
    codec = codec_of(name, (9, 12), None, weighted=True)
    rows, source = rows_of(codec, np.ones((1, 21))), np.arange(1)
    signal = np.frombuffer(b"\x01\0\xa0\x7f", np.uint8)
    for at in range(rows.nbytes - 3):
        hostile = np.frombuffer(rows.tobytes(), np.uint8).copy()
        hostile[at : at + 4] = signal
        with contextlib.suppress(MessageRejected):
            codec.check(source, hostile.view(codec.dtype).reshape(rows.shape))


@pytest.mark.parametrize("name", CODINGS)
@pytest.mark.parametrize("cut", [None, Cut(1, 8, 9)], ids=["whole", "fragments"])
def test_the_row_of_a_whole_model_has_its_last_number_and_zeros_for_what_was_not_sent(name: str, cut: Any) -> None:
    """Hashes of models are made of these rows."""
    codec = codec_of(name, (9, 12), cut)
    models = np.where(np.arange(21) == 20, [[-3.0], [3.0]], 1.0)
    rows, source = rows_of(codec, models), np.arange(2).repeat(codec.count)
    uavs, whole = codec.whole(source, rows)
    assert uavs.tolist() == [0, 1]
    assert (whole[0] != whole[1]).any()
    if cut is not None:
        uavs, part = codec.whole(source[1:], rows[1:])
        assert uavs.tolist() == [0, 1]
        assert not np.array_equal(part[0], whole[0])
        np.testing.assert_array_equal(part[1], whole[1])


FALSE: dict[str, Any] = {  # fragments, changed in one way
    "out of order": lambda rows: rows[[1, 0, 2, 3, 4, 5]],
    "twice": lambda rows: rows[[0, 0, 2, 3, 4, 5]],
    "beyond the model": lambda rows: np.concatenate([rows[:-1], np.where(rows[-1:] == 2, np.uint8(3), rows[-1:])]),
    "of another size": lambda rows: rows[:, :-1],
    "of another type": lambda rows: rows.astype(np.int16),
    "not a number": lambda rows: np.where(np.arange(rows.shape[1]) < 4, np.uint8(255), rows),
}


@pytest.mark.parametrize("how", FALSE)
def test_false_fragments_are_rejected(how: str) -> None:
    codec = codec_of("float32", (10,), Cut(1, 4, 9))
    rows, source = rows_of(codec, np.ones((2, 10))), np.arange(2).repeat(3)
    codec.check(source, rows)
    with pytest.raises(MessageRejected):
        codec.check(source, FALSE[how](rows))


@pytest.mark.parametrize("cut", [None, Cut(1, 8, 9)], ids=["whole", "fragments"])
def test_a_head_names_no_later_round_than_there_is(cut: Cut | None) -> None:
    codec = codec_of("float32", (10,), cut, head=HEAD_BYTES)
    heads = codec.heads(np.array([0, 4]), [b"", b""])
    rows = codec.rows(encoded(codec, np.ones((2, 10))), np.ones((2, 1)), None, heads)
    source = np.arange(2).repeat(codec.count)
    codec.check(source, rows, newest=4)
    with pytest.raises(MessageRejected, match="wrong-round: payload: a model based on round 4, at most 3"):
        codec.check(source, rows, newest=3)


@pytest.mark.parametrize("cut", [None, Cut(1, 4, 9)], ids=["whole", "fragments"])
def test_an_average_of_weighted_models_has_their_number_and_the_sum_of_their_weights(cut: Cut | None) -> None:
    codec = codec_of("float32", (10,), cut, weighted=True, most=np.array([3, 3]))
    models, source = np.arange(20.0).reshape(2, 10), np.arange(2).repeat(codec.count)
    behind = np.array([[1.0, 3.0, 2.0], [2.0, 1.0, 0.0]])[:, : codec.count]
    weights = behind * 50.0

    def written(weights: np.ndarray, behind: np.ndarray) -> np.ndarray:
        return codec.rows(encoded(codec, models), weights, behind)

    rows = written(weights, behind)
    assert codec.bits == 8 * rows.shape[1] == 32 * (12 if cut is None else 4 + 3)
    codec.check(source, rows, least=0)
    sent = behind > 0.0
    codec.check(source[sent.reshape(-1)], rows[sent.reshape(-1)])
    pieces = codec.read(rows[sent.reshape(-1)])
    assert (pieces.behind.tolist(), pieces.weights.tolist()) == (behind[sent].tolist(), weights[sent].tolist())
    np.testing.assert_array_equal(pieces.values[0], models[0, : 10 if cut is None else 4])
    for false in (0.0, -1.0, np.nan, np.inf, 4e30):  # of two or three models
        with pytest.raises(MessageRejected, match="weights"):
            codec.check(source, written(np.where(behind == behind.max(), false, weights), behind), least=0)
    for too_many in (4.0, 1.5):
        with pytest.raises(MessageRejected, match="averages"):
            codec.check(source, written(weights, np.where(behind == behind.max(), too_many, behind)), least=0)
    if cut is not None:
        with pytest.raises(MessageRejected, match="averages"):  # of no model
            codec.check(source, rows)
        with pytest.raises(MessageRejected, match="weights"):
            codec.check(source, written(np.maximum(weights, 1.0), behind), least=0)  # a weight of no model


# -- int8 and floats ----------------------------------------------------------------------------------------------


@st.composite
def drawn(draw: st.DrawFn, method: str = "mfgfl-hf", largest: float = 1e29) -> np.ndarray:
    """A few models of random weights over any range of magnitudes, some weights chosen with malice."""
    weights = sum(PARTS[method])
    dice = np.random.default_rng(draw(st.integers(0, 2**32)))
    powers = draw(st.tuples(*[st.floats(-324, np.log10(largest))] * 2))
    low, high = sorted(power + 0.0 for power in powers)  # from 0 to −0, NumPy says, is an interval of negative length
    table: np.ndarray = dice.uniform(-1, 1, (draw(st.integers(1, 3)), weights))
    table *= 10.0 ** dice.uniform(low, high, table.shape)
    chosen = st.tuples(st.integers(0, len(table) - 1), st.integers(0, weights - 1), st.floats(-largest, largest))
    for row, weight, value in draw(st.lists(chosen, max_size=6)):
        table[row, weight] = value
    return table


def scales_of(rows: np.ndarray, method: str) -> list[tuple[float, ...]]:
    """The scales, read with `struct` alone."""
    count, weights = len(PARTS[method]), sum(PARTS[method])
    return [struct.unpack_from(f"<{count}f", row.tobytes(), weights) for row in rows]


@pytest.mark.parametrize("method", FEDERATED)
def test_a_weight_is_off_by_at_most_half_a_step_of_its_part(method: str) -> None:
    codec = codec_of("int8", PARTS[method])
    ends = np.cumsum(PARTS[method])

    @QUICK
    @given(drawn(method))
    def check(meant: np.ndarray) -> None:
        coded = encoded(codec, meant)
        assert codec.valid(coded).all()
        off = np.abs(codec.decode(coded) - meant)
        for row, scales in enumerate(scales_of(rows_of(codec, meant), method)):
            for end, size, scale in zip(ends, PARTS[method], scales, strict=True):
                part = slice(end - size, end)
                assert off[row, part].max() <= scale * 0.5 * (1 + 1e-12)
                largest = np.abs(meant[row, part]).max()
                assert FINEST <= scale <= max(FINEST, largest / STEPS * (1 + 2**-23))  # no coarser than need be

    check()


def test_int8_fragments_have_scales_of_their_own() -> None:
    codec = codec_of("int8", (6, 4), Cut(1, 4, 9))
    model = np.array([[1e-3] * 4 + [1e3] * 2 + [1.0] * 4])
    np.testing.assert_allclose(codec.decode(encoded(codec, model)), model, rtol=1 / 250)
    assert (codec.count, codec.width) == (3, 4 + 2 * 4 + 4)  # pieces 0–3, 4–5 and 6–7, 8–9


@pytest.mark.parametrize("name", CODINGS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_weight_that_cannot_be_written_makes_its_own_row_unsound_and_no_other(name: str, bad: float) -> None:
    if name == "float64" and np.isfinite(bad):
        return
    codec, meant = codec_of(name, H), np.ones((3, 108))
    meant[1, 7] = bad
    assert codec.valid(encoded(codec, meant)).tolist() == [True, False, True]
    with pytest.raises(MessageRejected) as caught:
        receive(codec, rows_of(codec, meant))
    assert caught.value.reason == "non-finite"


def receive(codec: Codec, payload: np.ndarray) -> None:
    """What the world does with payloads: the reader of the message looks at floats, the codec at bytes."""
    uavs = np.arange(len(payload), dtype=np.int32)
    raw = wire.write_act(Act(1, 1, np.zeros((len(uavs), 2)), outbox=(Frames(FrameKind.UPLOAD, 1, uavs, payload),)))
    for frames in wire.read_act(raw).outbox:
        codec.check(frames.source, frames.payload)


BOUNDS = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-45, FINEST / 2, FINEST, COARSEST / 2, float(np.float32(3e38))]
SCALES = st.sampled_from(BOUNDS) | st.floats(width=32)


@QUICK
@given(st.binary(min_size=108, max_size=108), SCALES, SCALES)
def test_a_payload_is_steps_times_scales_and_is_rejected_if_one_is_beyond_its_bounds(
    steps: bytes, first: float, second: float
) -> None:
    codec, raw = codec_of("int8", H), steps + struct.pack("<2f", first, second)
    row, scales = np.frombuffer(raw, "u1")[None], np.array(struct.unpack_from("<2f", raw, 108))
    if ((scales >= FINEST) & (scales <= np.float32(COARSEST))).all() and 0x80 not in steps:
        codec.check(np.arange(1), row)
        np.testing.assert_array_equal(codec.read(row).values[0], np.frombuffer(steps, "i1") * scales.repeat(H))
    else:
        with pytest.raises(MessageRejected, match=r"^non-finite"):
            codec.check(np.arange(1), row)


# -- what rounding takes ------------------------------------------------------------------------------------------

RESIDUALS = "meanflock.residuals"  # in a checkpoint


def uploads(agent: Agent, until: int) -> list[tuple[np.ndarray, Frames]]:
    """What an agent learned by each round's tick, and what it sent then."""
    sent, seen = [], agent.act(nodes.sense(0)).models
    for tick in range(1, until):
        act = agent.act(nodes.sense(tick))
        sent += [(seen, batch) for batch in act.outbox if batch.kind == FrameKind.UPLOAD]
        seen = act.models
    return sent


@pytest.mark.parametrize("name", ["int8", "float16"])
def test_an_agent_s_uploads_add_up_to_its_models_but_for_the_residual_of_its_checkpoint(name: str) -> None:
    case = nodes.flown(f"federation.payload={name}", "federation.fraction=0.7")
    agent, codec = Agent(nodes.welcome(case)), plan_of(case).hops[0].codec
    heard, sent, meant = uploads(agent, 36), np.zeros((3, 246)), np.zeros((3, 246))
    assert len({len(batch.source) for _, batch in heard}) > 1
    for seen, batch in heard:
        rows = np.searchsorted(nodes.UAVS, batch.source)
        sent[rows] += codec.read(batch.payload).values
        meant[rows] += seen[rows]
    residuals = nodes.kept(agent, 36)[RESIDUALS]
    assert np.abs(residuals).max() > 0
    np.testing.assert_allclose(sent + residuals, meant, rtol=0, atol=1e-12)
    past = nodes.kept(agent, 37) | {RESIDUALS: residuals[:, :-1]}
    with pytest.raises(BadInput, match="residuals"):
        Agent(msgspec.structs.replace(nodes.welcome(case), memory=control.encode_record(past)))


def test_a_residual_pushes_no_model_beyond_the_largest_number_of_the_radio() -> None:
    """A half ends at 65504; 65488 lies between two of them, and 16 remain for the next upload."""
    feedback, row = Feedback(codec_of("float16", (1,)), np.arange(1), active=True), np.array([0])
    sent = [float(feedback.encode(row, np.array([[model]]), 1).numbers[0, 0]) for model in (65488.0, 65504.0)]
    assert sent == [65472.0, 65504.0]


def test_without_feedback_an_upload_is_the_rounded_model_and_no_residual_is_stored() -> None:
    case = nodes.flown("federation.payload=int8", "federation.error_feedback=false", "federation.fraction=1.0")
    agent, codec = Agent(nodes.welcome(case)), codec_of("int8", HF)
    for seen, batch in uploads(agent, 21):
        np.testing.assert_array_equal(batch.payload, rows_of(codec, seen))
    assert RESIDUALS not in nodes.kept(agent, 21)
