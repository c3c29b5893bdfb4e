"""What the world lets in: an Act must fit the node that sent it, the tick, and what the method may say."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from swarm import model, payload, state
from swarm.ascending import contains
from swarm.clusters import Clusters
from swarm.codec import expect
from swarm.errors import MessageRejected
from swarm.messages import OUTCOME_FLOATS, Act, FrameKind, Frames, Message
from swarm.relay import Relay
from swarm.rounds import Rounds
from swarm.scenario import Scenario
from worldsim.members import Member

_OVERHEAD_BYTES = 1024
_BYTES_A_ROW = 8 * OUTCOME_FLOATS + 9 + 4 * 8 * model.MODEL_FLOATS  # outcome, id, report, upload, residual, state


def limit(rows: int, scenario: Scenario) -> int:
    """The most bytes an honest Act of a node with that many UAVs can have."""
    known = 8 * state.SIZE * scenario.uavs if scenario.keeps_states else 0
    refused = 5 * scenario.uavs if not rows or scenario.federation.clusters > 1 else 0
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
    refused = set(message.refused)
    if refused and (len(refused) < len(message.refused) or not refused <= set(_averaged_by(member, tick, scenario))):
        raise MessageRejected("wrong-shape", "refused names UAVs that did not upload")
    if message.diverged and not np.isin(message.diverged, member.uavs).all():
        raise MessageRejected("wrong-shape", "diverged names UAVs of another node")
    if len(message.outbox) > 1 and len({frames.kind for frames in message.outbox}) != len(message.outbox):
        raise MessageRejected("wrong-shape", "two batches of one kind in one outbox")
    for frames in message.outbox:
        _check_frames(frames, member, scenario, float_)
    return message


def stray(frames: Frames, tick: int, rounds: Rounds, averaged: int) -> MessageRejected | None:
    """Why a batch does not belong to the round that is open for its kind in this tick; None where it does.

    Frames of a kind go on the air as those of one round: who names another would take everybody's models there, and
    the world would keep those of a round to come until then. Nor has a round room for models of UAVs that do not take
    part in it. `averaged`: the last round that was.
    """
    expected = rounds.of(frames.kind, tick)
    if frames.kind == FrameKind.GLOBAL and frames.round <= averaged:
        return MessageRejected("duplicate", f"round {frames.round} has been averaged")
    if frames.round != expected:
        return MessageRejected("wrong-round", f"{frames.kind.name} of round {frames.round}, expected {expected}")
    if frames.kind == FrameKind.UPLOAD and not (taking := contains(rounds.participants(expected), frames.source)).all():
        return MessageRejected(
            "wrong-round", f"UAVs {frames.source[~taking].tolist()} take no part in round {expected}"
        )
    return None


def _check_frames(frames: Frames, member: Member, scenario: Scenario, float_: np.dtype) -> None:
    if frames.kind not in _sayable(member, scenario):
        raise MessageRejected("wrong-kind", f"{frames.kind.name} frames from {member.name}")
    source = expect("source", frames.source, (None,), np.int32)
    if frames.kind == FrameKind.STATE:
        expect("payload", frames.payload, (len(source), state.SIZE), float_)
    elif frames.kind == FrameKind.RELAY:
        Relay(scenario).check(source, frames.payload)
    else:
        coding = payload.upload(scenario) if frames.kind == FrameKind.UPLOAD else payload.broadcast(scenario)
        coding.check(frames.payload, len(source))
    own = member.uavs if member.role == "agent" else np.array([scenario.federation.leader])
    if not len(source) or not (_same(own, source) or _some(own, source)):
        raise MessageRejected("wrong-shape", f"frames of {member.name} name UAVs {source.tolist()}")
    if frames.links is not None:
        raise MessageRejected("wrong-shape", "only the world says which links carried a frame")


def _same(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    """Whether sources are all UAVs of a node; `np.array_equal` takes twice as long."""
    return len(own) == len(source) and bool(np.logical_and.reduce(own == source))


def _some(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    """Whether sources are UAVs of a node, ascending."""
    return bool(contains(own, source).all() and (source[1:] > source[:-1]).all())


def _sayable(member: Member, scenario: Scenario) -> tuple[FrameKind, ...]:
    if member.role != "agent":
        return (FrameKind.GLOBAL,)
    if not scenario.method.is_federated:
        return (FrameKind.STATE,)
    relays = (FrameKind.RELAY,) if scenario.federation.clusters > 1 else ()
    return FrameKind.UPLOAD, FrameKind.STATE, *relays


def _averaged_by(member: Member, tick: int, scenario: Scenario) -> Collection[int]:
    """The UAVs whose models a node may average in a tick: a leader all, an agent those of clusters it heads."""
    if member.role != "agent":
        return range(scenario.uavs)
    if not Rounds(scenario).relays(tick):
        return ()
    return np.flatnonzero(contains(member.uavs, Clusters(scenario).head_of)).tolist()
