"""Error feedback: the part of a model that rounding takes is sent later."""

import msgspec
import numpy as np
import pytest

from meanflock.agent.node import Agent
from meanflock.federation.coding import Coding
from meanflock.federation.memory import Feedback
from meanflock.swarm.errors import BadInput
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.agent.nodes import UAVS, flown, kept, models, sense, welcome
from tests.methods import PARTS

HF = PARTS["mfgfl-hf"]
RESIDUALS = "meanflock.residuals"  # in a checkpoint


def test_a_weight_smaller_than_a_step_gets_through_only_with_feedback() -> None:
    coding = Coding("int8", PARTS["mfgfl-h"])
    model = np.zeros((1, 108))
    model[0, :3] = 1.0, 1.1e-3, -0.4e-3  # a step is 1/127
    for keeps in (True, False):
        feedback = Feedback(coding, 1, active=keeps)
        heard = [coding.decode(feedback.encode(np.array([0]), model))[0] for _ in range(1000)]
        average = np.mean(heard, axis=0)
        if keeps:
            np.testing.assert_allclose(average, model[0], atol=1e-5)
        else:
            np.testing.assert_allclose(average[:3], [1.0, 0.0, 0.0], atol=1e-7)


def uploads(agent: Agent, until: int) -> list[tuple[np.ndarray, Frames]]:
    """What an agent learned by each round's tick, and what it sent then."""
    sent, seen = [], models(agent.act(sense(0)))
    for tick in range(1, until):
        act = agent.act(sense(tick))
        sent += [(seen, batch) for batch in act.outbox if batch.kind == FrameKind.UPLOAD]
        seen = models(act)
    return sent


@pytest.mark.parametrize("name", ["int8", "float16"])
def test_an_agent_s_uploads_add_up_to_its_models_but_for_the_residual_of_its_checkpoint(name: str) -> None:
    of = flown(f"federation.payload={name}", "federation.fraction=0.7")
    agent, coding = Agent(welcome(of)), Coding(name, HF)  # type: ignore[arg-type]
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


@pytest.mark.parametrize(
    ("payload", "bits", "kept"),
    [("float32", 32, False), ("float16", 16, False), ("float16", 32, True), ("float32", 64, True), ("int8", 16, True)],
)
def test_a_residual_is_kept_where_a_payload_is_narrower_than_a_float_of_the_radio(
    payload: str, bits: int, kept: bool
) -> None:
    settings_ = (f"federation.payload={payload}", f"radio.bits_per_float={bits}")
    assert flown(*settings_).keeps_residuals == kept
    assert not flown(*settings_, method="mfg").keeps_residuals
