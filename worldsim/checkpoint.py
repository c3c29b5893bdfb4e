"""Checkpoints: the state of the world and the memory of the controllers between two ticks.

A checkpoint travels in the block of telemetry whose last row it continues from, and a long one also in the blocks after
it, so the run folder has both; the world itself needs no disk. The hash of the trajectory cannot be continued in the
middle, so resuming a run also takes the states of all ticks flown, which the run folder has.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.medium import Medium
from meanflock.federation.account import ModelsHash
from meanflock.federation.post import Post
from meanflock.swarm import __version__
from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import control
from meanflock.worldsim.barrier import Barrier, Commands
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.members import Member
from meanflock.worldsim.reporting import Reporter
from meanflock.worldsim.summary import Counters

SCHEMA = 11
EVERY_TICKS = 100
PART_BYTES = 8 * 2**20  # of a checkpoint in a block of telemetry; longer ones are sent in parts
MAX_BYTES = 512 * 2**20
_PART = struct.Struct(">BHH")  # mark, number, parts
_MARK = 0xC1  # no MessagePack object begins with it, so no whole checkpoint does


def split(body: bytes) -> list[bytes]:
    """A checkpoint as blocks of telemetry carry it: whole, or in parts of at most `PART_BYTES`."""
    if len(body) <= PART_BYTES:
        return [body]
    starts = range(0, len(body), PART_BYTES)
    return [
        _PART.pack(_MARK, number, len(starts)) + body[start : start + PART_BYTES] for number, start in enumerate(starts)
    ]


class Assembly:
    """Joins the parts of a checkpoint.

    Attributes:
        begun: whether the last part was the first one of its checkpoint, or the whole.
    """

    def __init__(self) -> None:
        self.begun = False
        self._parts: list[bytes] = []

    def add(self, part: bytes) -> bytes | None:
        """The checkpoint that a part completes; None if more must follow. Parts that do not fit are dropped."""
        if part[0] != _MARK:
            self.begun, self._parts = True, []
            return part
        _, number, parts = _PART.unpack_from(part)
        self.begun = number == 0
        if number == 0:
            self._parts = []
        elif number != len(self._parts):
            self._parts = []
            return None
        self._parts.append(part[_PART.size :])
        if len(self._parts) < parts:
            return None
        body, self._parts = b"".join(self._parts), []
        return body


class Memories:
    """The memories of the controllers of all UAVs, as their nodes replied.

    Attributes:
        arrays: by name, (N, …) each; zeros for a UAV without an agent.
        present: (N,), UAVs whose memory is in `arrays`.
    """

    def __init__(self, uavs: int) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        self.present: NDArray[np.bool_] = np.zeros(uavs, dtype=bool)

    def take(self, member: Member, record: Mapping[str, Any]) -> None:
        """Add the memory in the reply of one node.

        Raises:
            MessageRejected: the arrays do not have the node's rows, differ in form from those of other nodes, or would
                be too large for all UAVs.
        """
        uavs = len(self.present)
        for name, array in record.items():
            if not isinstance(array, np.ndarray) or not array.ndim or len(array) != member.rows:
                raise MessageRejected("wrong-shape", f"memory {name!r}: expected {member.rows} rows")
        if not self.present.any():  # the first node decides the form
            row_bytes = sum(array.nbytes for array in record.values()) // member.rows
            if row_bytes * uavs > MAX_MEMORY_BYTES:
                raise MessageRejected("oversized", f"a memory of {row_bytes} bytes of each of {uavs} UAVs")
            try:
                self.arrays = {name: np.zeros((uavs, *array.shape[1:]), array.dtype) for name, array in record.items()}
            except ValueError as error:  # rows of no bytes, but more numbers than NumPy can address
                raise MessageRejected("wrong-shape", f"a memory of {_form(record)}: {error}") from error
        if (form := _form(record)) != (wanted := _form(self.arrays)):
            raise MessageRejected("wrong-shape", f"a memory of {form}, expected {wanted} as of the others")
        for name, array in record.items():
            self.arrays[name][member.place] = array
        self.present[member.place] = True


def _form(arrays: Mapping[str, NDArray[Any]]) -> dict[str, str]:
    """The type and shape of a row, by name."""
    return {name: f"{array.dtype} {array.shape[1:]}" for name, array in arrays.items()}


@dataclass(frozen=True)
class Resumption:
    """A checkpoint to continue from, and the states (tick + 1, N, 4) of the ticks before it."""

    checkpoint: Mapping[str, Any]
    history: Floats

    @property
    def tick(self) -> int:
        """The first tick to fly."""
        return int(self.checkpoint["flight"]["tick"])

    @property
    def block(self) -> int:
        """Number of the block of telemetry that carried the checkpoint."""
        return int(self.checkpoint["block"])

    def memory(self, uavs: NDArray[np.intp]) -> bytes:
        """The memory of a node with these UAVs, as a record; empty where every UAV was lost, so that none was asked."""
        memory: Mapping[str, NDArray[Any]] = self.checkpoint["memory"]
        if not memory:
            return b""
        return control.encode_record({name: np.ascontiguousarray(array[uavs]) for name, array in memory.items()})

    def encode(self) -> bytes:
        """The bytes of a file for `load`, with which a world process starts."""
        return control.encode_record({"checkpoint": dict(self.checkpoint), "history": self.history})

    @staticmethod
    def decode(body: bytes, history: Floats) -> "Resumption":
        """Read a checkpoint, as telemetry carries it.

        Raises:
            BadInput: not a checkpoint of this version.
        """
        return Resumption(_checked(_record(body, "checkpoint")), history)

    @staticmethod
    def load(path: Path) -> "Resumption":
        """Read a file with the bytes of `encode`.

        Raises:
            BadInput: the file cannot be read, or contains something else.
        """
        try:
            record = _record(path.read_bytes(), str(path))
        except OSError as error:
            raise BadInput(f"{path}: {error.strerror}; give a file made by `meanflock resume`") from error
        if set(record) != {"checkpoint", "history"} or not isinstance(record["history"], np.ndarray):
            raise BadInput(f"{path}: not what a run is resumed from; use `meanflock resume`")
        return Resumption(_checked(record["checkpoint"]), record["history"])


class Checkpoints:
    """Makes checkpoints of a world, and restores them."""

    def __init__(
        self,
        flight: Flight,
        air: Medium,
        counters: Counters,
        commands: Commands,
        post: Post,
        models: ModelsHash,
        reporter: Reporter,
    ) -> None:
        self._scenario = flight.scenario
        self._flight = flight
        self._air = air
        self._counters = counters
        self._commands = commands
        self._post = post
        self._models = models
        self._reporter = reporter
        self._memories: Memories | None = None  # those of the last tick, if all nodes were asked for them

    def collect(self, barrier: Barrier, drop: Callable[[MessageRejected, str], None]) -> None:
        """Gather the memories in the replies of this tick; none if that of a UAV in the mission is missing."""
        memories = Memories(self._scenario.uavs)
        for name, act in barrier.acts.items():
            member = barrier.asked[name]
            if member.rows and act.memory:
                try:
                    memories.take(member, control.decode_record(act.memory))
                except MessageRejected as error:
                    drop(error, f"the memory of {name}")
        self._memories = memories if memories.present[~self._flight.lost].all() else None

    def keep(self, wall_s: Callable[[], float]) -> None:
        """Send a checkpoint, with all rows before it, if the last tick gathered the memories.

        `wall_s`: wall-clock time flown so far.
        """
        memories, self._memories = self._memories, None
        if memories is None or self._reporter.holds_checkpoint:
            return
        body = control.encode_record(
            {
                "schema": SCHEMA,
                "scenario": self._scenario.sha256(),
                "plugins": [list(plugin) for plugin in self._scenario.plugins()],
                "version": __version__,
                "block": self._reporter.block,
                "flight": self._flight.snapshot(),
                "air": self._air.snapshot(),
                "counters": self._counters.snapshot(wall_s()),
                "post": self._post.snapshot(),
                "models": self._models.digest,
                "commands": self._commands.accelerations,
                "largest": self._commands.largest,
                "summed": self._commands.summed,
                "memory": memories.arrays,
            }
        )
        if len(body) <= MAX_BYTES:
            self._reporter.flush(split(body))

    def restore(self, resume: Resumption) -> None:
        """Continue from a checkpoint.

        Raises:
            BadInput: it belongs to another scenario or other plug-ins, or is incomplete.
        """
        checkpoint: Any = resume.checkpoint
        if checkpoint.get("scenario") != self._scenario.sha256():
            raise BadInput("the checkpoint is of another scenario; resume a run with its own scenario.toml")
        for stored, now in zip(checkpoint.get("plugins", ()), self._scenario.plugins(), strict=False):
            if tuple(stored) != now:
                raise BadInput(f"the checkpoint is of {stored[0]} {stored[1]!r} of {stored[2]}; here it is of {now[2]}")
        try:
            self._flight.restore(checkpoint["flight"], resume.history)
            self._air.restore(checkpoint["air"])
            self._counters.restore(checkpoint["counters"])
            self._post.restore(checkpoint["post"])
            self._models.digest = bytes(checkpoint["models"])
            self._commands.accelerations[...] = checkpoint["commands"]
            self._commands.largest[...] = checkpoint["largest"]
            self._commands.summed[...] = checkpoint["summed"]
            self._reporter.begin(checkpoint["block"] + 1, self._flight.tick + 1)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadInput(f"the run cannot be resumed: {error}") from error


def _record(raw: bytes, what: str) -> dict[str, Any]:
    try:
        return control.decode_record(raw)
    except MessageRejected as error:
        raise BadInput(f"{what}: damaged ({error}); the run cannot be resumed from it") from error


def _checked(checkpoint: Any) -> Mapping[str, Any]:
    if not isinstance(checkpoint, dict) or checkpoint.get("schema") != SCHEMA:
        raise BadInput(f"the checkpoint is not of schema {SCHEMA}; resume the run with the version that flew it")
    return checkpoint
