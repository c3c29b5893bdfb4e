"""All it takes to go on with a run: the state of the world and what the controllers remember, between two ticks.

A checkpoint travels in the block of telemetry whose last row it goes on from: the ground keeps the run folder, the
world may have no disk, and whoever has the one has the other. The hash of the trajectory cannot be taken up in the
middle, so whoever resumes a run also brings the states of all ticks flown, which the run folder has.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.medium import Medium
from meanflock.federation.post import Post
from meanflock.swarm import __version__
from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import control
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.members import Member
from meanflock.worldsim.replies import Commands
from meanflock.worldsim.reporting import Reporter
from meanflock.worldsim.summary import Counters

SCHEMA = 6
EVERY_TICKS = 100
MAX_BYTES = 24 * 2**20  # a larger one would push the telemetry out of the outbox


class Memories:
    """What the UAVs replied to a request for all that their controllers remember.

    arrays: (N, …) each, by name; zeros where a UAV is lost and nobody could be asked. known: (N,), whose it has.
    """

    def __init__(self, uavs: int) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        self.known: NDArray[np.bool_] = np.zeros(uavs, dtype=bool)

    def take(self, member: Member, record: Mapping[str, Any]) -> None:
        """Enters the reply of one node.

        Raises:
            MessageRejected: its arrays are not of its rows, not like those of the others, or too large for everyone's.
        """
        uavs = len(self.known)
        for name, array in record.items():
            if not isinstance(array, np.ndarray) or not array.ndim or len(array) != member.rows:
                raise MessageRejected("wrong-shape", f"memory {name!r}: expected {member.rows} rows")
        if not self.known.any():  # the first: all have arrays like it
            row_bytes = sum(array.nbytes for array in record.values()) // member.rows
            if row_bytes * uavs > MAX_MEMORY_BYTES:
                raise MessageRejected("oversized", f"a memory of {row_bytes} bytes of each of {uavs} UAVs")
            try:
                self.arrays = {name: np.zeros((uavs, *array.shape[1:]), array.dtype) for name, array in record.items()}
            except ValueError as error:  # of no bytes, and more of them than NumPy can address
                raise MessageRejected("wrong-shape", f"a memory of {_form(record)}: {error}") from error
        if (form := _form(record)) != (wanted := _form(self.arrays)):
            raise MessageRejected("wrong-shape", f"a memory of {form}, expected {wanted} as of the others")
        for name, array in record.items():
            self.arrays[name][member.place] = array
        self.known[member.place] = True


def _form(arrays: Mapping[str, NDArray[Any]]) -> dict[str, str]:
    """The type and shape of a row, by name."""
    return {name: f"{array.dtype} {array.shape[1:]}" for name, array in arrays.items()}


@dataclass(frozen=True)
class Resumption:
    """Where to go on: a checkpoint, and the states (tick + 1, N, 4) of the ticks before it."""

    checkpoint: Mapping[str, Any]
    history: Floats

    @property
    def tick(self) -> int:
        """The first tick to be flown."""
        return int(self.checkpoint["flight"]["tick"])

    @property
    def block(self) -> int:
        """The block of telemetry that carried it."""
        return int(self.checkpoint["block"])

    def memory(self, uavs: NDArray[np.intp]) -> bytes:
        """What the rows of a node with these UAVs had in memory, as a record."""
        kept: Mapping[str, NDArray[Any]] = self.checkpoint["memory"]
        return control.encode_record({name: np.ascontiguousarray(array[uavs]) for name, array in kept.items()})

    def encode(self) -> bytes:
        """The bytes a world process is started with."""
        return control.encode_record({"checkpoint": dict(self.checkpoint), "history": self.history})

    @staticmethod
    def of(body: bytes, history: Floats) -> "Resumption":
        """From the bytes of a checkpoint, as telemetry carries them.

        Raises:
            BadInput: it is none.
        """
        return Resumption(_checked(_record(body, "checkpoint")), history)

    @staticmethod
    def load(path: Path) -> "Resumption":
        """From a file with the bytes of `encode`.

        Raises:
            BadInput: the file cannot be read or is something else.
        """
        try:
            record = _record(path.read_bytes(), str(path))
        except OSError as error:
            raise BadInput(f"{path}: {error.strerror}; give a file made by `meanflock resume`") from error
        if set(record) != {"checkpoint", "history"} or not isinstance(record["history"], np.ndarray):
            raise BadInput(f"{path}: not what a run is resumed from; use `meanflock resume`")
        return Resumption(_checked(record["checkpoint"]), record["history"])


class Checkpoints:
    """All parts of a world that a checkpoint is of."""

    def __init__(
        self,
        flight: Flight,
        air: Medium,
        counters: Counters,
        commands: Commands,
        post: Post,
        reporter: Reporter,
    ) -> None:
        self._scenario, self._flight, self._air, self._counters = flight.scenario, flight, air, counters
        self._commands, self._post, self._reporter = commands, post, reporter
        self._memories: Memories | None = None  # where, in the last tick, all were asked for what they remember

    def collect(self, barrier: Barrier, drop: Callable[[MessageRejected, str], None]) -> None:
        """Takes what everyone who is not lost replied to a request for it; nothing where somebody did not."""
        memories = Memories(self._scenario.uavs)
        for name, act in barrier.acts.items():
            member = barrier.asked[name]
            if member.rows and act.memory:
                try:
                    memories.take(member, control.decode_record(act.memory))
                except MessageRejected as error:
                    drop(error, f"the memory of {name}")
        self._memories = memories if memories.known[~self._flight.lost].all() else None

    def keep(self, wall_s: Callable[[], float]) -> None:
        """A checkpoint, if everyone said what it remembers in the last tick; it goes out with all rows before it.

        `wall_s`: how long the flight has taken so far.
        """
        memories, self._memories = self._memories, None
        if memories is None or self._reporter.outbox.holds_checkpoint:
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
                "commands": self._commands.accelerations,
                "largest": self._commands.largest,
                "summed": self._commands.summed,
                "memory": memories.arrays,
            }
        )
        if len(body) <= MAX_BYTES:
            self._reporter.flush(body)

    def restore(self, resume: Resumption) -> None:
        """Goes on from a checkpoint.

        Raises:
            BadInput: it is of another scenario, or of other plug-ins, or incomplete.
        """
        kept: Any = resume.checkpoint
        if kept.get("scenario") != self._scenario.sha256():
            raise BadInput("the checkpoint is of another scenario; resume a run with its own scenario.toml")
        for was, now in zip(kept.get("plugins", ()), self._scenario.plugins(), strict=False):
            if tuple(was) != now:
                raise BadInput(f"the checkpoint is of {was[0]} {was[1]!r} of {was[2]}; here it is of {now[2]}")
        try:
            self._flight.restore(kept["flight"], resume.history)
            self._air.restore(kept["air"])
            self._counters.restore(kept["counters"])
            self._post.restore(kept["post"])
            self._commands.accelerations[...] = kept["commands"]
            self._commands.largest[...] = kept["largest"]
            self._commands.summed[...] = kept["summed"]
            self._reporter.begin(kept["block"] + 1, self._flight.tick + 1)
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
