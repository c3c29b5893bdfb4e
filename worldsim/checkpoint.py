"""Checkpoints: the state of the world and the memory of the controllers between two ticks.

A checkpoint travels in the block of telemetry whose last row it continues from, and a long one also in the blocks after
it, so the run folder has both; the world itself needs no disk. The hash of the trajectory cannot be continued in the
middle, so resuming a run also takes the states of all ticks flown, which the run folder has.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.groups import Group, group_number
from meanflock.federation.plan import plugins_of
from meanflock.swarm import __version__
from meanflock.swarm.declared import MEMORY_TICKS, PRESENT, most_memory
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import control

SCHEMA = 16
EVERY_TICKS = MEMORY_TICKS
PART_BYTES = 8 * 2**20  # of a checkpoint in a block of telemetry; longer ones are sent in parts
_WORLD_SHARE = 2  # of a checkpoint, by the memories that it may have: the rest is of the world, and mail of rounds
_PART = struct.Struct(">BHH")  # mark, number, parts
_MARK = 0xC1  # no MessagePack object begins with it, so no whole checkpoint does


def most_bytes(uavs: int) -> int:
    """Most bytes of a checkpoint of so many UAVs; a longer one is not stored."""
    return _WORLD_SHARE * most_memory(uavs)


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
        arrays: of each group by name, (M, …) each; zeros for a UAV without an agent.
        present: (N,), UAVs whose memory is in `arrays`.
    """

    def __init__(self, groups: Sequence[Group]) -> None:
        self._groups = groups
        self.arrays: list[dict[str, NDArray[Any]]] = [{} for _ in groups]
        self.present: NDArray[np.bool_] = np.zeros(sum(len(group.uavs) for group in groups), dtype=bool)

    def take(self, uavs: NDArray[np.intp], record: Mapping[str, Any]) -> None:
        """Add the memory in the reply of one node with some UAVs of a group, ascending.

        Raises:
            MessageRejected: the arrays do not have the node's rows, differ in form from those of other nodes, or would
                be too large for all UAVs.
        """
        for name, array in record.items():
            if not isinstance(array, np.ndarray) or not array.ndim or len(array) != len(uavs):
                raise MessageRejected("wrong-shape", f"memory {name!r}: expected {len(uavs)} rows")
        number = group_number(self._groups, uavs)
        group = self._groups[number].uavs
        if not self.present[group].any():  # the first node decides the form
            row_bytes = sum(array.nbytes for array in record.values()) // len(uavs)
            if row_bytes * len(self.present) > most_memory(len(self.present)):
                raise MessageRejected("oversized", f"a memory of {row_bytes} bytes of each of {len(self.present)} UAVs")
            try:
                self.arrays[number] = {
                    name: np.zeros((len(group), *array.shape[1:]), array.dtype) for name, array in record.items()
                }
            except ValueError as error:  # rows of no bytes, but more numbers than NumPy can address
                raise MessageRejected("wrong-shape", f"a memory of {_form(record)}: {error}") from error
        if (form := _form(record)) != (wanted := _form(self.arrays[number])):
            raise MessageRejected("wrong-shape", f"a memory of {form}, expected {wanted} as of the others")
        place = group.searchsorted(uavs)
        for name, array in record.items():
            self.arrays[number][name][place] = array
        self.present[uavs] = True


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
        return int(self.checkpoint["world"]["flight"]["tick"])

    @property
    def block(self) -> int:
        """Number of the block of telemetry that carried the checkpoint."""
        return int(self.checkpoint["block"])

    def memory(self, groups: Sequence[Group], uavs: NDArray[np.intp]) -> bytes:
        """The memory of a node with these UAVs of one of the groups of a plan, as a record; empty where no UAV was
        asked, because all were lost or had not joined. `PRESENT` are those that were, if others were not."""
        number, present = group_number(groups, uavs), self.checkpoint["has_memory"][uavs]
        if not present.any():
            return b""
        place = groups[number].uavs.searchsorted(uavs)
        memory: Mapping[str, NDArray[Any]] = self.checkpoint["memory"][number]
        record = {name: np.ascontiguousarray(array[place]) for name, array in memory.items()}
        return control.encode_record(record if present.all() else record | {PRESENT: present})

    def check(self, scenario: Scenario) -> None:
        """Check that the checkpoint is of this scenario.

        Raises:
            BadInput: it belongs to another scenario or other plug-ins.
        """
        if self.checkpoint.get("scenario") != scenario.sha256():
            raise BadInput("the checkpoint is of another scenario; resume a run with its own scenario.toml")
        for stored, now in zip(self.checkpoint.get("plugins", ()), plugins_of(scenario), strict=False):
            if tuple(stored) != now:
                raise BadInput(f"the checkpoint is of {stored[0]} {stored[1]!r} of {stored[2]}; here it is of {now[2]}")

    def encode(self) -> bytes:
        """The bytes of a file for `load`, with which a world process starts."""
        return control.encode_record({"checkpoint": dict(self.checkpoint), "history": self.history})

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


def encoded(scenario: Scenario, parts: Mapping[str, Any]) -> bytes:
    """The bytes of a checkpoint of a flight of a scenario."""
    return control.encode_record(
        {
            "schema": SCHEMA,
            "scenario": scenario.sha256(),
            "plugins": [list(plugin) for plugin in plugins_of(scenario)],
            "version": __version__,
            **parts,
        }
    )


def decoded(body: bytes) -> Mapping[str, Any]:
    """Read a checkpoint, as telemetry carries it.

    Raises:
        BadInput: not a checkpoint of this version.
    """
    return _checked(_record(body, "checkpoint"))


def _record(raw: bytes, what: str) -> dict[str, Any]:
    try:
        return control.decode_record(raw)
    except MessageRejected as error:
        raise BadInput(f"{what}: damaged ({error}); the run cannot be resumed from it") from error


def _checked(checkpoint: Any) -> Mapping[str, Any]:
    if not isinstance(checkpoint, dict) or checkpoint.get("schema") != SCHEMA:
        raise BadInput(f"the checkpoint is not of schema {SCHEMA}; resume the run with the version that flew it")
    return checkpoint
