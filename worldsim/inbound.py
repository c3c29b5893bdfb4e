"""What the world lets in: an Act must fit the node that sent it, the tick, and what the method may say."""

import numpy as np

from swarm import model, payload, state
from swarm.codec import expect
from swarm.errors import MessageRejected
from swarm.messages import OUTCOME_FLOATS, Act, FrameKind, Frames, Message
from swarm.methods import Method
from swarm.scenario import Scenario
from worldsim.members import Member

_OVERHEAD_BYTES = 1024
_BYTES_A_ROW = 8 * OUTCOME_FLOATS + 9 + 4 * 8 * model.MODEL_FLOATS  # outcome, id, report, upload, residual, state


def limit(rows: int, scenario: Scenario) -> int:
    """The most bytes an honest Act of a node with that many UAVs can have."""
    known = 8 * state.SIZE * scenario.uavs if scenario.keeps_states else 0
    refused = 5 * scenario.uavs if not rows else 0
    return _OVERHEAD_BYTES + refused + max(1, rows) * (_BYTES_A_ROW + known)


def check(message: Message, run: int, tick: int, member: Member, scenario: Scenario, float_: np.dtype) -> Act:
    """`message` itself, if it is an Act of this run, this tick and this node.

    Raises:
        MessageRejected: `wrong-kind`, `wrong-run`, `stale` or `wrong-shape`.
    """
    if not isinstance(message, Act):
        raise MessageRejected("wrong-kind", f"{type(message).__name__}, expected Act")
    if message.run != run:
        raise MessageRejected("wrong-run", f"run {message.run:#x}, this is {run:#x}")
    if message.tick != tick:
        raise MessageRejected("stale", f"answer to tick {message.tick} in tick {tick}")
    rows = len(member.uavs)
    expect("outcome", message.outcome, (rows, OUTCOME_FLOATS), np.float64)
    if message.report is not None:
        expect("report", message.report, (rows, model.MODEL_FLOATS), np.float64)
    if message.known is not None:
        expect("known", message.known, (rows if scenario.keeps_states else 0, scenario.uavs, state.SIZE), np.float64)
    if message.residuals is not None:
        floats = model.shared_floats(scenario.method)
        expect("residuals", message.residuals, (rows if scenario.keeps_residuals else 0, floats), np.float64)
    if message.refused and (member.role == "agent" or not set(message.refused) <= set(range(scenario.uavs))):
        raise MessageRejected("wrong-shape", "refused names UAVs that did not upload")
    if message.diverged and not np.isin(message.diverged, member.uavs).all():
        raise MessageRejected("wrong-shape", "diverged names UAVs of another node")
    if len({frames.kind for frames in message.outbox}) != len(message.outbox):
        raise MessageRejected("wrong-shape", "two batches of one kind in one outbox")
    for frames in message.outbox:
        _check_frames(frames, member, scenario, float_)
    return message


def stray(frames: Frames, expected: int, averaged: int) -> MessageRejected | None:
    """Why a batch does not belong to the round it should, `expected`; None where it does.

    Frames of a kind go on the air as those of one round: who names another would take everybody's models there, and
    the world would keep those of a round to come until then. `averaged`: the last round that was.
    """
    if frames.kind == FrameKind.GLOBAL and frames.round <= averaged:
        return MessageRejected("duplicate", f"round {frames.round} has been averaged")
    if frames.round != expected:
        return MessageRejected("wrong-round", f"{frames.kind.name} of round {frames.round}, expected {expected}")
    return None


def _check_frames(frames: Frames, member: Member, scenario: Scenario, float_: np.dtype) -> None:
    if frames.kind not in _sayable(member, scenario.method):
        raise MessageRejected("wrong-kind", f"{frames.kind.name} frames from {member.name}")
    source = expect("source", frames.source, (None,), np.int32)
    if frames.kind == FrameKind.STATE:
        expect("payload", frames.payload, (len(source), state.SIZE), float_)
    else:
        coding = payload.upload(scenario) if frames.kind == FrameKind.UPLOAD else payload.broadcast(scenario)
        coding.check(frames.payload, len(source))
    own = member.uavs if member.role == "agent" else np.array([scenario.federation.leader])
    if not len(source) or not np.isin(source, own).all() or (np.diff(source) <= 0).any():
        raise MessageRejected("wrong-shape", f"frames of {member.name} name UAVs {source.tolist()}")
    if frames.links is not None:
        raise MessageRejected("wrong-shape", "only the world says which links carried a frame")


def _sayable(member: Member, method: Method) -> set[FrameKind]:
    if member.role != "agent":
        return {FrameKind.GLOBAL}
    return {FrameKind.UPLOAD, FrameKind.STATE} if method.is_federated else {FrameKind.STATE}
