"""The closed set of messages between processes: frozen, typed, tagged. Nothing else is ever on the bus.

Arrays are little-endian; who receives one checks the shape it expects with `control.expect`. N is the number of UAVs of
the swarm, M the number a node holds as rows, K the number of diagnostics and W the number of weights that the
controller reports. Sense and Act fly in every tick, in a layout of their own (`swarm.tick`); all others are control
messages.
"""

import enum
from typing import TypeAlias

import msgspec
import numpy as np

from meanflock.swarm.plugins import Door


class _Message(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, eq=False):
    """Encoded as an array: tag first, then the fields in order."""


NOBODY = np.zeros(0, dtype=np.int32)
NOBODY.flags.writeable = False


class FrameKind(enum.IntEnum):
    """What a radio frame carries."""

    UPLOAD = 0  # a UAV's model, to the head of its cluster: the leader, where there is but one
    GLOBAL = 1  # the averaged model, to every UAV
    STATE = 2  # what a controller broadcasts, its own state as a rule, to UAVs in range
    RELAY = 3  # the mean of a cluster, from its head to the leader


class Frames(msgspec.Struct, frozen=True, eq=False):
    """A batch of radio frames of one kind sent in one tick, one row a transmission."""

    kind: FrameKind
    round: int  # of the federation; of STATE frames, which of its sender's broadcasts of the tick
    source: np.ndarray  # (S,) i4, the UAVs that transmit, ascending
    payload: np.ndarray  # (S, L) numbers or (S, B) bytes, one row for each UAV that sends, see federation/coding.py
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
    memory: bytes = b""  # of a run that is resumed: a record of what the rows of this node had in memory
    plugins: tuple[tuple[Door, str, str], ...] = ()  # door, name and fingerprint of what the run needs


class Refusal(_Message, frozen=True, tag="refusal"):
    """The world's answer where a node cannot take part; a welcomed node's to the world where it cannot, after all."""

    reason: str
    for_now: bool = False  # what stands against it may pass: a UAV is free again once its agent is lost
    over: bool = False  # the flight is over


class Ready(_Message, frozen=True, tag="ready"):
    """A welcomed node listens on its own keys."""

    run: int


class Sense(msgspec.Struct, frozen=True, eq=False):
    """World to node, a tick: what its own sensors and its own radio give."""

    run: int
    tick: int
    states: np.ndarray  # (M, 4) f8
    report: bool = False  # answer with what was learned
    checkpoint: bool = False  # answer with all that must be kept to go on from here
    inbox: tuple[Frames, ...] = ()
    memory: bytes = b""  # to a leader that takes over: the state of the aggregation rule, a record


class Act(msgspec.Struct, frozen=True, eq=False):
    """Node to world, a tick: what it does."""

    run: int
    tick: int
    commands: np.ndarray  # (M, 2 + K) f8: acceleration (m/s²), then K diagnostics (instrumentation, not radio)
    lost: np.ndarray = NOBODY  # (D,) i4, UAVs whose controller has failed
    refused: np.ndarray = NOBODY  # (R,) i4: k, UAV k's state is not believed; -1-k, its upload is not averaged
    models: np.ndarray | None = None  # (M, W) f8, what was learned, where asked for
    memory: bytes = b""  # at a checkpoint, and of a leader after a round: a record
    outbox: tuple[Frames, ...] = ()


class Stop(_Message, frozen=True, tag="stop"):
    """World to a node: it can go home."""

    run: int
    reason: str
    lost: bool = False  # the world does not wait for it any more; the flight may go on


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
    diagnostics: np.ndarray  # (T, N, K) f4, likewise
    status: np.ndarray  # (T, N) u1, see `Status`
    energy: np.ndarray  # (T, N) f4, J since take-off
    swarm: np.ndarray  # (T, len(SWARM_COLUMNS)) f8
    links: np.ndarray  # (K, 5) i4: [tick, source, target, FrameKind, slots; negative slots: outage]
    report_ticks: np.ndarray  # (R,) i4
    reports: np.ndarray  # (R, W) f4, what the leader's UAV has learned
    spread: np.ndarray  # (R,) f8, root-mean-square distance of the models from their mean
    events: tuple[Event, ...] = ()
    checkpoint: bytes = b""  # all it takes to go on after the last row; most blocks have none
    diagnostic_names: tuple[str, ...] = ()  # (K,), what the controller calls its diagnostics


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

Message: TypeAlias = Join | Welcome | Refusal | Ready | Stop | Event | Telemetry | Received | Finished
