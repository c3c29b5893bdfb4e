"""Codings of models: bounds of rounding, payloads that are rejected, and feedback of what rounding takes."""

import struct

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.agent.node import Agent
from meanflock.federation.coding import COARSEST, FINEST, STEPS, Coding
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from tests.agent.nodes import UAVS, flown, kept, sense, welcome
from tests.methods import FEDERATED, PARTS

QUICK = settings(max_examples=100, deadline=None, database=None)
H, HF = PARTS["mfgfl-h"], PARTS["mfgfl-hf"]


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


def scales_of(coded: np.ndarray, method: str) -> list[tuple[float, ...]]:
    """The scales, read with `struct` alone."""
    count, weights = len(PARTS[method]), sum(PARTS[method])
    return [struct.unpack_from(f"<{count}f", row.tobytes(), weights) for row in coded]


@pytest.mark.parametrize("method", FEDERATED)
def test_a_weight_is_off_by_at_most_half_a_step_of_its_part(method: str) -> None:
    coding = Coding("int8", PARTS[method])
    ends = np.cumsum(PARTS[method])

    @QUICK
    @given(drawn(method))
    def check(meant: np.ndarray) -> None:
        coded = coding.encode(meant)
        assert coding.valid(coded).all()
        off = np.abs(coding.decode(coded) - meant)
        for row, scales in enumerate(scales_of(coded, method)):
            for end, size, scale in zip(ends, PARTS[method], scales, strict=True):
                part = slice(end - size, end)
                assert off[row, part].max() <= scale * 0.5 * (1 + 1e-12)
                largest = np.abs(meant[row, part]).max()
                assert FINEST <= scale <= max(FINEST, largest / STEPS * (1 + 2**-23))  # no coarser than need be

    check()


@pytest.mark.parametrize("name", ["int8", "float16", "float32", "float64"])
def test_a_decoded_model_is_encoded_again_without_loss(name: str) -> None:
    coding = Coding(name, HF)

    @QUICK
    @given(drawn(largest=6e4))
    def check(meant: np.ndarray) -> None:
        once = coding.encode(meant)
        assert coding.encode(coding.decode(once)).tobytes() == once.tobytes()

    check()


@pytest.mark.parametrize("name", ["int8", "float16", "float32"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_weight_that_cannot_be_written_makes_its_own_row_unsound_and_no_other(name: str, bad: float) -> None:
    coding = Coding(name, H)
    meant = np.ones((3, 108))
    meant[1, 7] = bad
    coded = coding.encode(meant)
    assert coding.valid(coded).tolist() == [True, False, True]
    with pytest.raises(MessageRejected) as caught:
        receive(coding, coded)
    assert caught.value.reason == "non-finite"


def receive(coding: Coding, payload: np.ndarray) -> None:
    """What the world does with payloads: the reader of the message looks at floats, the coding at bytes."""
    uavs = np.arange(len(payload), dtype=np.int32)
    raw = wire.write_act(Act(1, 1, np.zeros((len(uavs), 2)), outbox=(Frames(FrameKind.UPLOAD, 1, uavs, payload),)))
    for frames in wire.read_act(raw).outbox:
        coding.check(frames.source, frames.payload)


BOUNDS = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-45, FINEST / 2, FINEST, COARSEST / 2, float(np.float32(3e38))]
SCALES = st.sampled_from(BOUNDS) | st.floats(width=32)


@QUICK
@given(st.binary(min_size=108, max_size=108), SCALES, SCALES)
def test_a_payload_is_steps_times_scales_and_is_rejected_if_one_is_beyond_its_bounds(
    steps: bytes, first: float, second: float
) -> None:
    coding, raw = Coding("int8", H), steps + struct.pack("<2f", first, second)
    row, scales = np.frombuffer(raw, "u1")[None], np.array(struct.unpack_from("<2f", raw, 108))
    if ((scales >= FINEST) & (scales <= np.float32(COARSEST))).all() and 0x80 not in steps:
        coding.check(np.arange(1), row)
        np.testing.assert_array_equal(coding.decode(row)[0], np.frombuffer(steps, "i1") * scales.repeat(H))
    else:
        with pytest.raises(MessageRejected, match=r"^non-finite"):
            coding.check(np.arange(1), row)


RESIDUALS = "meanflock.residuals"  # in a checkpoint


def uploads(agent: Agent, until: int) -> list[tuple[np.ndarray, Frames]]:
    """What an agent learned by each round's tick, and what it sent then."""
    sent, seen = [], agent.act(sense(0)).models
    for tick in range(1, until):
        act = agent.act(sense(tick))
        sent += [(seen, batch) for batch in act.outbox if batch.kind == FrameKind.UPLOAD]
        seen = act.models
    return sent


@pytest.mark.parametrize("name", ["int8", "float16"])
def test_an_agent_s_uploads_add_up_to_its_models_but_for_the_residual_of_its_checkpoint(name: str) -> None:
    of = flown(f"federation.payload={name}", "federation.fraction=0.7")
    agent, coding = Agent(welcome(of)), Coding(name, HF)
    heard, sent, meant = uploads(agent, 36), np.zeros((3, 246)), np.zeros((3, 246))
    assert len({len(batch.source) for _, batch in heard}) > 1
    for seen, batch in heard:
        rows = np.searchsorted(UAVS, batch.source)
        sent[rows] += coding.decode(batch.payload)
        meant[rows] += seen[rows]
    residuals = kept(agent, 36)[RESIDUALS]
    assert np.abs(residuals).max() > 0
    np.testing.assert_allclose(sent + residuals, meant, rtol=0, atol=1e-12)
    past = kept(agent, 37) | {RESIDUALS: residuals[:, :-1]}
    with pytest.raises(BadInput, match="residuals"):
        Agent(msgspec.structs.replace(welcome(of), memory=control.encode_record(past)))


def test_without_feedback_an_upload_is_the_rounded_model_and_no_residual_is_stored() -> None:
    of = flown("federation.payload=int8", "federation.error_feedback=false", "federation.fraction=1.0")
    agent, coding = Agent(welcome(of)), Coding("int8", HF)
    for seen, batch in uploads(agent, 21):
        np.testing.assert_array_equal(batch.payload, coding.encode(seen))
    assert RESIDUALS not in kept(agent, 21)
