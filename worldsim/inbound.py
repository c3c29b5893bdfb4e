"""What the world lets in: an Act must fit the node that sent it, the tick, and what its controller has declared."""

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.post import Post
from meanflock.federation.topology.base import Role
from meanflock.swarm import state
from meanflock.swarm.ascending import contains
from meanflock.swarm.declared import MAX_BROADCASTS
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from meanflock.worldsim.members import LEADER, Member


class Replies:
    """The Acts of a run, as they must be."""

    def __init__(self, scenario: Scenario, run: int, post: Post) -> None:
        self._scenario, self._run, self._post = scenario, run, post
        self._columns = state.AXES + len(scenario.declared.diagnostics)
        self._weights, self._most_said = scenario.declared.weights, scenario.declared.broadcast_numbers
        self._float = FLOAT_OF_BITS[scenario.radio.bits_per_float]
        self._leader = np.array([scenario.federation.leader])

    def table(self) -> Floats:
        """Room for the commands of all UAVs in a tick, (N, 2 + K)."""
        return np.zeros((self._scenario.uavs, self._columns))

    def read(self, member: Member, tick: int, raw: bytes, into: Floats | None = None) -> Act:
        """The Act of a node, a reply to a request of that tick.

        `into`: (N, 2 + K), where its commands are written, whether it is let in or not; None for nowhere.

        Raises:
            MessageRejected: it is none; the reason is one of those in `errors.MessageRejected`.
        """
        rows = np.zeros((member.rows, self._columns)) if into is None else into[member.place]
        act = wire.read_act(raw, rows)
        if into is not None and not isinstance(member.place, slice):
            into[member.place] = rows
        if act.run != self._run:
            raise MessageRejected("wrong-run", f"run {act.run:#x}, this is {self._run:#x}")
        if act.tick != tick:
            raise MessageRejected("stale", f"reply to tick {act.tick} in tick {tick}")
        if act.models is not None and act.models.shape[1] != self._weights:
            raise MessageRejected(
                "wrong-shape", f"models: expected {(member.rows, self._weights)}, got {act.models.shape}"
            )
        if len(act.refused):
            self._check_refused(member, tick, act.refused)
        if len(act.lost) and not contains(member.uavs, act.lost).all():
            raise MessageRejected("wrong-shape", "lost names UAVs of another node")
        if act.outbox:
            self._check_outbox(member, act.outbox)
        return act

    def _check_refused(self, member: Member, tick: int, refused: NDArray[np.int32]) -> None:
        """A leader may refuse uploads; an agent what it received of others, and in the tick in which its heads average
        uploads to them."""
        uavs = self._scenario.uavs
        if len(np.unique(refused)) < len(refused) or not ((refused >= -uavs) & (refused < uavs)).all():
            raise MessageRejected("wrong-shape", "refused names UAVs that are not there, or one twice")
        uploads, states = ~refused[refused < 0], refused[refused >= 0]
        if member.role == LEADER and len(states):
            raise MessageRejected("wrong-shape", "a leader receives no states")
        if len(uploads):
            self._post.check_refused(_role(member), tick, uploads, member.uavs)
        if member.rows == 1 and contains(member.uavs, states).any():
            raise MessageRejected("wrong-shape", "refused names the node's own UAV")

    def _check_outbox(self, member: Member, outbox: tuple[Frames, ...]) -> None:
        if len(outbox) > 1:
            named = {(frames.kind, frames.round if frames.kind == FrameKind.STATE else 0) for frames in outbox}
            if len(named) != len(outbox) or len(outbox) > MAX_BROADCASTS + len(FrameKind):
                raise MessageRejected("wrong-shape", "two batches of one kind in one outbox, or too many")
        for frames in outbox:
            self._check_frames(member, frames)

    def _check_frames(self, member: Member, frames: Frames) -> None:
        kind, source, said = frames.kind, frames.source, frames.payload
        if kind != FrameKind.STATE:
            self._post.check(_role(member), frames)
        elif member.role == LEADER:
            raise MessageRejected("wrong-kind", f"{kind.name} frames from {member.name}")
        else:
            if said.dtype.kind == "f" and said.dtype != self._float:
                raise MessageRejected("wrong-shape", f"payload: expected floats {self._float}, got {said.dtype}")
            if not 0 < said.shape[1] <= self._most_said or frames.round >= MAX_BROADCASTS:
                raise MessageRejected("wrong-shape", f"broadcast {frames.round} of {said.shape[1]} numbers")
        own = self._leader if member.role == LEADER else member.uavs
        if not len(source) or not (_same(own, source) or _some(own, source)):
            raise MessageRejected("wrong-shape", f"frames of {member.name} name UAVs {source.tolist()}")
        if frames.links is not None:
            raise MessageRejected("wrong-shape", "only the world says which links carried a frame")


def _role(member: Member) -> Role:
    return "leader" if member.role == LEADER else "agent"


def _same(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    """Whether sources are all UAVs of a node; `np.array_equal` takes twice as long."""
    return len(own) == len(source) and bool(np.logical_and.reduce(own == source))


def _some(own: NDArray[np.intp], source: NDArray[np.int32]) -> bool:
    """Whether sources are UAVs of a node, ascending."""
    return bool(contains(own, source).all() and (source[1:] > source[:-1]).all())
