"""All messages between processes: frozen, typed, tagged.

Arrays are little-endian; the receiver checks their shapes with `control.expect`. N: number of UAVs of the swarm. M:
number of UAVs of a node. K: number of diagnostics. W: number of weights that the controller reports. Sense and Act are
sent in every tick, in a layout of their own (`net/tick.py`); all others are control messages.
"""

import enum
from collections.abc import Sequence
from typing import Any, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.wire import BATCH_BYTES
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.plugins import PluginKind


class _ControlMessage(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, eq=False):
    """Encoded as an array: tag first, then the fields in order."""


NOBODY = np.zeros(0, dtype=np.int32)
NOBODY.flags.writeable = False


class FrameKind(enum.IntEnum):
    """Content of a radio frame. The numbers also give the order of random draws."""

    UPLOAD = 0  # a UAV's model, to the UAV that averages: the leader, or the head of a cluster
    GLOBAL = 1  # the averaged model, to every UAV
    STATE = 2  # a broadcast of a controller, mostly its own state, to UAVs in range
    RELAY = 3  # the mean of a cluster, from its head to the leader


class LinkColumn(enum.IntEnum):
    """Columns of the links of a tick: each pair of UAVs between which a batch of frames went by radio."""

    TICK = 0
    SOURCE = 1
    TARGET = 2
    KIND = 3  # a FrameKind
    SLOTS = 4  # on the air; of a model in fragments, the sum over those of the tick
    DELIVERED = 5  # 1, or 0 if lost
    WAITED = 6  # slots until the band was free; of fragments, the longest


class Frames(msgspec.Struct, frozen=True, eq=False):
    """A batch of radio frames of one kind sent in one tick, one row a transmission."""

    kind: FrameKind
    round: int  # of the federation; of STATE frames, the number of the broadcast in the tick
    source: np.ndarray  # (S,) i4, the UAVs that transmit, ascending; a UAV comes once for each fragment
    payload: np.ndarray  # (S, L) numbers or (S, B) bytes, a row for each sender, see federation/coding.py
    links: np.ndarray | None = None  # (K, 2) i4, of received frames: [row of payload, receiving UAV]
    slots: np.ndarray | None = None  # (K,) i4, of models within the world: slots that each link took, 0 without radio

    @property
    def wire_bytes(self) -> int:
        """Bytes of the batch without links in a message of a tick."""
        return BATCH_BYTES + 4 * self.source.size + self.payload.nbytes


def frames_of(fields: Sequence[Any]) -> Frames:
    """The batch with these fields, in their order."""
    kind, *others = fields
    return Frames(FrameKind(kind), *others)


class Join(_ControlMessage, frozen=True, tag="join"):
    """A node asks the world to take part."""

    role: str  # "agent" or "leader"
    rows: int  # UAVs an agent can hold; 0 for the leader
    uav: int = -1  # the first UAV; -1: the world chooses
    token: int = 0  # random number of the node, by which the world recognises a repeated Join; 0 for none


class Welcome(_ControlMessage, frozen=True, tag="welcome"):
    """Answer of the world to a node that it admits, with all that the node needs."""

    run: int
    node: str  # the name under which the node publishes
    uavs: tuple[int, ...]  # the UAVs of the node, ascending
    tick: int  # the first tick of its requests
    scenario: bytes  # canonical JSON
    initial_states: np.ndarray  # (N, 4) floats of the radio: the mission plan, known to all UAVs
    memory: bytes = b""  # in a resumed run: a record of the memory of the node's UAVs
    plugins: tuple[tuple[PluginKind, str, str], ...] = ()  # kind, name and fingerprint of the plug-ins of the run
    stations: int = 0  # nodes of the radio after the UAVs


class Refusal(_ControlMessage, frozen=True, tag="refusal"):
    """Answer of the world that a node cannot take part; or message of an admitted node that it cannot."""

    reason: str
    for_now: bool = False  # the node may ask again: its place may become free
    over: bool = False  # the flight is over, or never needs such a node


class Ready(_ControlMessage, frozen=True, tag="ready"):
    """Message of an admitted node: it listens on its own keys."""

    run: int


class Sense(msgspec.Struct, frozen=True, eq=False):
    """Request of a tick, world to node: the states of its UAVs, and the frames that they received."""

    run: int
    tick: int
    states: np.ndarray  # (M, 4) f8
    report: bool = False  # the reply must have the learned weights
    checkpoint: bool = False  # the reply must have the memory
    inbox: tuple[Frames, ...] = ()
    memory: bytes = b""  # a record: to a leader that takes over, the state of the rule; to an agent, goals that change


class Act(msgspec.Struct, frozen=True, eq=False):
    """Reply of a tick, node to world: commands, and frames to send."""

    run: int
    tick: int
    commands: np.ndarray  # (M, 2 + K) f8: acceleration (m/s²), then K diagnostics
    lost: np.ndarray = NOBODY  # (D,) i4, UAVs whose controller has failed
    refused_uploads: np.ndarray = NOBODY  # (R,) i4, UAVs whose upload is not averaged
    refused_states: np.ndarray = NOBODY  # (R,) i4, UAVs whose state is implausible
    waiting: np.ndarray = NOBODY  # (W,) i4, UAVs at which the aggregation rule waits for more models
    models: np.ndarray | None = None  # (M, W) f8, the learned weights, if requested
    memory: bytes = b""  # a record, at a checkpoint and of a leader after a round
    outbox: tuple[Frames, ...] = ()


FAILED = "failed"  # kind of the report that something else failed
UNTRAINED = "untrained"  # kind of the report that a training gave no model
UNAVERAGED = "unaveraged"  # kind of the report that the aggregation rule failed at UAVs
DREW = "drew"  # kind of the report that a plug-in draws from a global random generator


class Event(_ControlMessage, frozen=True, tag="event"):
    """Message of a node: something is wrong. The world makes an event of it.

    kind: `UNTRAINED` if a training of one of its UAVs, `uavs`, gave no model; `UNAVERAGED` if the aggregation rule
    failed at some of them; `DREW`, without `text` and `uavs`, if a plug-in draws from a global random generator;
    `FAILED` if the controller failed with `uavs`, or, without these, for all else.
    """

    tick: int
    kind: str
    text: str
    uavs: tuple[int, ...] = ()


class Stop(_ControlMessage, frozen=True, tag="stop"):
    """Message of the world that a node should end."""

    run: int
    reason: str
    lost: bool = False  # the world counts the node as lost; the flight may continue


class Telemetry(_ControlMessage, frozen=True, tag="telemetry"):
    """Block of telemetry, world to ground stations: T consecutive rows of the flight, one a tick."""

    run: int
    block: int  # 0, 1, 2 …, so that a listener notices a missing one
    first_tick: int
    states: np.ndarray  # (T, N, 4) f8
    accelerations: np.ndarray  # (T, N, 2) f4, of the tick before the row
    diagnostics: np.ndarray  # (T, N, K) f4, likewise; behind them the columns of the vehicle, at the end of the tick
    status: np.ndarray  # (T, N) u1, see `Status`
    energy: np.ndarray  # (T, N) f4, J since take-off
    swarm: np.ndarray  # (T, len(SWARM_COLUMNS)) f8
    links: np.ndarray  # (K, 7) i4: the columns of `LinkColumn`
    report_ticks: np.ndarray  # (R,) i4
    reports: np.ndarray  # (R, W) f4, learned weights of the leader's UAV
    spread: np.ndarray  # (R,) f8, root-mean-square distance of the models from their mean
    events: tuple[FlightEvent, ...] = ()
    checkpoint: bytes = b""  # state of the run after the last row; most blocks have none
    diagnostic_names: tuple[str, ...] = ()  # (K,), names of the diagnostics and columns
    has_diagnostic: np.ndarray | None = None  # u1, 0 where a UAV has no such number, see `has_or_none`


def has_or_none(has: NDArray[np.bool_]) -> NDArray[np.uint8] | None:
    """Mask (T, N, K) of the diagnostics that UAVs have in rows, as `Telemetry` has it.

    Returns:
        (T, N, K); (N, K) if all rows are equal; None if every UAV has all.
    """
    if has.all():
        return None
    return (has[0] if (has == has[0]).all() else has).astype(np.uint8)


class Acknowledgement(_ControlMessage, frozen=True, tag="received"):
    """Acknowledgement, listener to world: every block up to this one is stored."""

    run: int
    block: int


class Finished(_ControlMessage, frozen=True, tag="finished"):
    """Summary of a finished flight, world to ground stations, which acknowledge it as a block."""

    run: int
    block: int  # the number after that of the last Telemetry
    summary: bytes  # JSON object


class Status(enum.IntEnum):
    """Status of a UAV in the mission."""

    FLYING = 0
    ARRIVED = 1
    LOST = 2
    LANDED = 3


SWARM_COLUMNS = (  # cumulative since take-off unless named otherwise
    "uplink_bits",
    "relay_bits",
    "broadcast_bits",
    "state_bits",
    "deliveries",
    "outages",
    "airtime_s",
    "phi_A",
    "phi_C",
    "phi_C_distinct",
    "collisions",
    "arrived",
    "round",  # now
    "held_commands",  # in real time, as the next
    "deadline_misses",
)

Message: TypeAlias = Join | Welcome | Refusal | Ready | Stop | Event | Telemetry | Acknowledgement | Finished
