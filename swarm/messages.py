"""The closed set of messages between processes: frozen, typed, tagged. Nothing else is ever on the bus.

Arrays are little-endian and carry their own shape; who receives one checks the shape it expects with
`codec.expect`. N is the number of UAVs of the swarm, M the number this node holds as rows.
"""

import enum
from typing import TypeAlias

import msgspec
import numpy as np


class _Message(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, eq=False):
    """Encoded as an array: tag first, then the fields in order."""


class FrameKind(enum.IntEnum):
    """What a radio frame carries."""

    UPLOAD = 0  # a UAV's model, to the head of its cluster: the leader, where there is but one
    GLOBAL = 1  # the averaged model, to every UAV
    STATE = 2  # a UAV's own state, to UAVs in range
    RELAY = 3  # the mean of a cluster, from its head to the leader


class Frames(_Message, frozen=True):
    """Radio frames of one kind sent in one tick, one row a transmission."""

    kind: FrameKind
    round: int  # of the federation; 0 where none applies
    source: np.ndarray  # (S,) i4, the UAVs that transmit, ascending
    payload: np.ndarray  # (S, L) floats or (S, B) bytes, a row what is transmitted, see swarm/payload.py
    links: np.ndarray | None = None  # (K, 2) i4, on the way in: [row of payload, receiving UAV]


class Join(_Message, frozen=True, tag="join"):
    """A node asks the world to take part."""

    role: str  # "agent" or "leader"
    rows: int  # UAVs an agent can hold; 0 for the leader
    uav: int = -1  # the first of them, where the agent is not free to take any
    token: int = 0  # drawn by the node: a Join that is repeated asks for no second place; 0 for none


class Welcome(_Message, frozen=True, tag="welcome"):
    """The world's answer: all a node needs to begin."""

    run: int
    node: str  # the name under which the node publishes
    uavs: tuple[int, ...]  # the rows it holds, ascending
    tick: int  # the first tick it will be asked to act in
    scenario: bytes  # canonical JSON
    initial_states: np.ndarray  # (N, 4) floats as wide as the radio's: the mission plan every UAV shares
    models: np.ndarray | None = None  # (M, 246) f8: of a run that is resumed, the minds the rows had
    known: np.ndarray | None = None  # (M, N, 4) f8: and the states they knew, where the method keeps any
    residuals: np.ndarray | None = None  # (M, L) f8: and what rounding took from their last uploads, where it is kept


class Refusal(_Message, frozen=True, tag="refusal"):
    """The world's answer where a node cannot take part."""

    reason: str
    for_now: bool = False  # what stands against it may pass: a UAV is free again once its agent is lost


class Ready(_Message, frozen=True, tag="ready"):
    """A welcomed node listens on its own keys."""

    run: int


class Sense(_Message, frozen=True, tag="sense"):
    """World to node: what its own sensors and its own radio give in this tick."""

    run: int
    tick: int
    states: np.ndarray  # (M, 4) f8
    report: bool  # answer with the whole models
    inbox: tuple[Frames, ...] = ()
    checkpoint: bool = False  # answer with all that must be kept to go on from here


class Act(_Message, frozen=True, tag="act"):
    """Node to world: what it does in this tick."""

    run: int
    tick: int
    outcome: np.ndarray  # (M, 5) f8: acceleration (m/s²), then e_H, e_F, φ_G (instrumentation, not radio)
    diverged: tuple[int, ...] = ()  # UAVs whose learner is no longer finite
    outbox: tuple[Frames, ...] = ()
    report: np.ndarray | None = None  # (M, 246) f8, the whole models where asked for
    known: np.ndarray | None = None  # (M, N, 4) f8, at a checkpoint the states each row knows, if it keeps any
    refused: tuple[int, ...] = ()  # of the leader or a head: UAVs whose upload it will not average
    residuals: np.ndarray | None = None  # (M, L) f8, at a checkpoint what rounding took from the last uploads, if kept


class Stop(_Message, frozen=True, tag="stop"):
    """World to everyone: the flight is over."""

    run: int
    reason: str


LOST = "lost: "  # how the reason of a Stop begins that goes to a node the world does not wait for any more


class Event(_Message, frozen=True, tag="event"):
    """Something worth a line in the log and a mark on the timeline."""

    tick: int
    kind: str
    text: str
    uavs: tuple[int, ...] = ()


class Telemetry(_Message, frozen=True, tag="telemetry"):
    """World to whoever listens: T consecutive rows of the flight, row n being the state at tick n."""

    run: int
    block: int  # 0, 1, 2 …: a listener can tell whether it missed one
    first_tick: int
    states: np.ndarray  # (T, N, 4) f8
    accelerations: np.ndarray  # (T, N, 2) f4, of the tick that led here
    diagnostics: np.ndarray  # (T, N, 3) f4, likewise
    status: np.ndarray  # (T, N) u1, see `Status`
    energy: np.ndarray  # (T, N) f4, J since take-off
    swarm: np.ndarray  # (T, len(SWARM_COLUMNS)) f8
    links: np.ndarray  # (K, 5) i4: [tick, source, target, FrameKind, slots; negative slots: outage]
    report_ticks: np.ndarray  # (R,) i4
    reports: np.ndarray  # (R, 246) f4, the leader UAV's model
    spread: np.ndarray  # (R,) f8, root-mean-square distance of the models from their mean
    events: tuple[Event, ...] = ()
    checkpoint: bytes = b""  # all it takes to go on after the last row; most blocks have none


class Received(_Message, frozen=True, tag="received"):
    """Listener to world: every block up to this one is safe."""

    run: int
    block: int


class Finished(_Message, frozen=True, tag="finished"):
    """World to whoever listens: the flight is over and this is its summary. A listener acknowledges it as a block."""

    run: int
    block: int  # the number after that of the last Telemetry
    summary: bytes  # JSON object


class Status(enum.IntEnum):
    """A UAV's state of the mission."""

    FLYING = 0
    ARRIVED = 1
    LOST = 2


DIAGNOSTICS = ("hjb_residual", "fpk_residual", "phi_G")
OUTCOME_FLOATS = 2 + len(DIAGNOSTICS)

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
    "arrived",  # now
    "round",  # now
    "held_commands",  # in real time, as the next
    "deadline_misses",
)

Message: TypeAlias = Join | Welcome | Refusal | Ready | Sense | Act | Stop | Event | Telemetry | Received | Finished
