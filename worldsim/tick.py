"""A tick from outside of the world: what it tells all UAVs, what they say, and the row that is left of it."""

from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.mailbox import Letter
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.state import Floats, Mask, States, Vectors
from meanflock.swarm.wire.messages import NOBODY, Act, Frames
from meanflock.worldsim.checkpoint import Memories
from meanflock.worldsim.failures import Reports

Uavs: TypeAlias = NDArray[np.intp]


class Senses(NamedTuple):
    """What all UAVs are told in a tick.

    states: (N, 4). awake: (N,), UAVs that take part in the tick, neither lost nor paused. present: (N + B,), these and
    the stations that are neither. lost: (N,).
    idle: (N,), UAVs that no command moves: lost ones, and those on the ground; None for no UAV.
    heard: frames that arrived at UAVs that are awake, with their links. letters: models that wait to be averaged, see
    `mailbox.mail_for`. newest: number of the last letter. leads: whether a round needs the leader in this tick.
    rule_record: state of the aggregation rule, for a leader that takes over. report: whether learned weights are
    reported. checkpoint: whether memories are. guided: UAVs (K,) that are told another goal. goals: (K, d), these, m.
    killed: UAVs that the fault script kills now. leaders_killed: number of
    leaders that it kills now.
    """

    tick: int
    states: States
    awake: Mask
    present: Mask
    lost: Mask
    idle: Mask | None
    heard: list[Frames]
    letters: tuple[Letter, ...]
    newest: int
    leads: bool
    rule_record: bytes
    report: bool
    checkpoint: bool
    guided: Uavs
    goals: Vectors
    killed: Uavs
    leaders_killed: int


class Acts(msgspec.Struct, eq=False):
    """What all UAVs say in a tick, and what became of their nodes.

    commands: (N, 2 + K), accelerations in m/s² and diagnostics. outbox: the frames to send, those of the leader first.
    failed: UAVs whose controller failed. refused_uploads: UAVs whose models a node could not average.
    refused_states: UAVs whose states are implausible. waiting: UAVs at which the aggregation rule waits for more
    models. models: (N, W) learned weights, if they were asked for; NaN for UAVs without an answer. memories: of the
    controllers, if they were asked for and no node was just lost. rule_record: state of the aggregation rule after a
    round; None for no change. has_leader: whether a node leads. steered: number of commands that clients gave.
    news: what became of the nodes since the last tick, in order of time. reports: what nodes report of failures.
    """

    commands: Floats
    outbox: list[Frames] = []
    failed: NDArray[np.integer] = NOBODY
    refused_uploads: NDArray[np.integer] = NOBODY
    refused_states: NDArray[np.integer] = NOBODY
    waiting: NDArray[np.integer] = NOBODY
    models: Floats | None = None
    memories: Memories | None = None
    rule_record: bytes | None = None
    has_leader: bool = True
    steered: int = 0
    news: list[FlightEvent] = []
    reports: Reports = msgspec.field(default_factory=Reports)

    def add(self, reply: Act) -> None:
        """Add the UAVs that the reply of a node names."""
        if len(reply.lost):
            self.failed = np.concatenate([self.failed, reply.lost])
        if len(reply.refused_uploads):
            self.refused_uploads = np.concatenate([self.refused_uploads, reply.refused_uploads])
        if len(reply.refused_states):
            self.refused_states = np.concatenate([self.refused_states, reply.refused_states])
        if len(reply.waiting):
            self.waiting = np.concatenate([self.waiting, reply.waiting])


class Row(NamedTuple):
    """A tick of a flight, after it was flown.

    states: (N, 4) and status (N,), at the end of the tick. accelerations: (N, 2) m/s², of the tick. diagnostics:
    (N, K), of the controller in the tick, then what the vehicle shows at its end. links: (K, 7), the links that were
    used, see `Telemetry`. events: since the row before. weights: (W,), learned by the leader's UAV, if they were
    reported, and the spread of all models. memories: of the controllers, where a checkpoint is due.
    """

    tick: int
    states: States
    status: NDArray[np.uint8]
    accelerations: Vectors
    diagnostics: Floats
    links: NDArray[np.int32]
    events: list[FlightEvent]
    weights: tuple[Floats, float] | None = None
    memories: Memories | None = None
