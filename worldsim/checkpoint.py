"""All it takes to go on with a run: the state of the world and what the controllers remember, between two ticks.

A checkpoint travels in the block of telemetry whose last row it goes on from: the ground keeps the run folder, the
world may have no disk, and whoever has the one has the other. The hash of the trajectory cannot be taken up in the
middle, so whoever resumes a run also brings the states of all ticks flown, which the run folder has.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import control
from meanflock.worldsim.members import Member

SCHEMA = 5
EVERY_TICKS = 100
MAX_BYTES = 24 * 2**20  # a larger one would push the telemetry out of the outbox


class Memories:
    """What the UAVs replied to a request for all that their controllers remember."""

    def __init__(self, uavs: int) -> None:
        self._uavs = uavs
        self._arrays: dict[str, NDArray[Any]] = {}  # (N, …) each
        self._names: set[str] | None = None  # of the first reply; all have the same
        self._bytes = 0  # of all these arrays
        self._from: NDArray[np.bool_] = np.zeros(uavs, dtype=bool)

    def take(self, member: Member, record: Mapping[str, Any]) -> None:
        """Enters the reply of one node.

        Raises:
            MessageRejected: its arrays are not of its rows, not like those of the others, or too large for everyone's.
        """
        if self._names is None:
            self._names = set(record)
        if set(record) != self._names:
            raise MessageRejected("wrong-shape", f"a memory of {sorted(record)}, expected {sorted(self._names)}")
        for name, array in record.items():
            if not isinstance(array, np.ndarray) or not array.ndim or len(array) != member.rows:
                raise MessageRejected("wrong-shape", f"memory {name!r}: expected {member.rows} rows")
            whole = self._arrays.get(name)
            if whole is None:
                row_bytes = array.nbytes // member.rows
                self._bytes += row_bytes * self._uavs
                if self._bytes > MAX_MEMORY_BYTES:
                    raise MessageRejected(
                        "oversized", f"memory {name!r}: {row_bytes} bytes of each of {self._uavs} UAVs"
                    )
                whole = self._arrays[name] = np.zeros((self._uavs, *array.shape[1:]), array.dtype)
            if whole.shape[1:] != array.shape[1:] or whole.dtype != array.dtype:
                raise MessageRejected("wrong-shape", f"memory {name!r}: {array.shape} {array.dtype}, unlike the others")
        for name, array in record.items():
            self._arrays[name][member.place] = array
        self._from[member.place] = True

    def complete(self, needed: NDArray[np.bool_]) -> bool:
        """Whether every UAV that is `needed` (N,) has replied."""
        return bool(self._from[needed].all())

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """All of it; zeros where a UAV is lost and nobody could be asked."""
        return self._arrays


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


def encode(parts: Mapping[str, Any]) -> bytes:
    """The bytes of a checkpoint, as telemetry carries them."""
    return control.encode_record({"schema": SCHEMA, **parts})


def _record(raw: bytes, what: str) -> dict[str, Any]:
    try:
        return control.decode_record(raw)
    except MessageRejected as error:
        raise BadInput(f"{what}: damaged ({error}); the run cannot be resumed from it") from error


def _checked(checkpoint: Any) -> Mapping[str, Any]:
    if not isinstance(checkpoint, dict) or checkpoint.get("schema") != SCHEMA:
        raise BadInput(f"the checkpoint is not of schema {SCHEMA}; resume the run with the version that flew it")
    return checkpoint
