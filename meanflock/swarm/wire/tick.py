"""The two messages of a tick ⇄ bytes of the fixed layout of `kernels/wire.py`.

`kernels.read` checks that a message is well-formed, consistent in its sizes and finite, and that its frames name UAVs
and rows that are there. The receiver checks run, tick and sender.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from meanflock import kernels
from meanflock.kernels.wire import ACT, DTYPES, FIRST, SENSE, Batch, Message
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.messages import NOBODY, Act, FrameKind, Frames, Sense

REPORT, CHECKPOINT = 1, 2  # flags of a Sense
TYPES = (bytes([SENSE]), bytes([ACT]))  # second byte of a message of a tick; that of a control message begins a text

_DTYPES = tuple(np.dtype(name) for name in DTYPES)
_CODE = {dtype: code for code, dtype in enumerate(_DTYPES)}
_KINDS = tuple(FrameKind)
_FLOAT, _INT = np.dtype("<f8"), np.dtype("<i4")


def read_sense(raw: bytes, states: Floats | None = None, uavs: int = 0) -> Sense:
    """Read a Sense; its arrays are views of `raw`.

    Args:
        states: (M, 4), array to which the states are written, which must have this shape; None: none.
        uavs: number of UAVs of the swarm, to check whom the frames name; 0: unchecked.

    Raises:
        MessageRejected: `malformed`, `wrong-shape`, `non-finite` or `wrong-kind`.
    """
    _, run, tick, flags, rows, columns, tables, batches = _read(raw, SENSE, states, uavs)
    if flags & ~(REPORT | CHECKPOINT):
        raise MessageRejected("malformed", f"flags {flags:#x} of a Sense")
    memory, size = tables
    if states is None:
        states = np.ndarray((rows, columns), _FLOAT, raw, FIRST)
    if not (flags or batches or size):
        return Sense(run, tick, states)
    inbox = frames_in(raw, batches) if batches else ()
    return Sense(run, tick, states, bool(flags & REPORT), bool(flags & CHECKPOINT), inbox, raw[memory : memory + size])


def read_act(raw: bytes, commands: Floats | None = None) -> Act:
    """Read an Act; its arrays are views of `raw`.

    Args:
        commands: (M, 2 + K), array to which the commands are written, which must have this shape; None: none.

    Raises:
        MessageRejected: `malformed`, `wrong-shape`, `non-finite` or `wrong-kind`.
    """
    _, run, tick, flags, rows, columns, tables, batches = _read(raw, ACT, commands)
    if flags:
        raise MessageRejected("malformed", f"flags {flags:#x} of an Act")
    if commands is None:
        commands = np.ndarray((rows, columns), _FLOAT, raw, FIRST)
    lost, lost_size, refused, refused_size, models, models_size, memory, memory_size = tables
    if not (batches or lost_size or refused_size or models_size or memory_size):
        return Act(run, tick, commands)
    width, left = divmod(models_size // 8, rows) if rows else (0, models_size)
    if left:
        raise MessageRejected("wrong-shape", f"{models_size} bytes of models of {rows} UAVs")
    return Act(
        run,
        tick,
        commands,
        np.ndarray(lost_size // 4, _INT, raw, lost) if lost_size else NOBODY,
        np.ndarray(refused_size // 4, _INT, raw, refused) if refused_size else NOBODY,
        np.ndarray((rows, width), _FLOAT, raw, models) if models_size else None,
        raw[memory : memory + memory_size],
        frames_in(raw, batches) if batches else (),
    )


def write_sense(sense: Sense) -> bytes:
    """The bytes of a Sense."""
    states, flags = sense.states, REPORT * sense.report | CHECKPOINT * sense.checkpoint
    rows, columns = states.shape
    return kernels.write(
        SENSE,
        sense.run,
        sense.tick,
        flags,
        rows,
        columns,
        _plain(states),
        (sense.memory,),
        frames_out(sense.inbox) if sense.inbox else (),
    )


def write_act(act: Act) -> bytes:
    """The bytes of an Act."""
    rows, columns = act.commands.shape
    lost = NOBODY if act.lost is NOBODY else _plain(act.lost, _INT)
    refused = NOBODY if act.refused is NOBODY else _plain(act.refused, _INT)
    tables = lost, refused, b"" if act.models is None else _plain(act.models), act.memory
    outbox = frames_out(act.outbox) if act.outbox else ()
    return kernels.write(ACT, act.run, act.tick, 0, rows, columns, _plain(act.commands), tables, outbox)


def frames_in(raw: bytes, batches: Iterable[Batch]) -> tuple[Frames, ...]:
    """The batches of a message that was read.

    Raises:
        MessageRejected: `wrong-kind`: the kind of a batch is unknown.
    """
    frames = []
    for kind, number, code, width, sources, source, payload, links, link in batches:
        if kind >= len(_KINDS):
            raise MessageRejected("wrong-kind", f"frames of kind {kind}")
        frames.append(
            Frames(
                _KINDS[kind],
                number,
                np.ndarray(sources, _INT, raw, source),
                np.ndarray((sources, width), _DTYPES[code], raw, payload),
                np.ndarray((links, 2), _INT, raw, link) if links else None,
            )
        )
    return tuple(frames)


def frames_out(frames: Iterable[Frames]) -> list[tuple[int, int, int, int, Any, Any, Any]]:
    """Batches as `kernels.write` takes them."""
    return [
        (
            int(batch.kind),
            batch.round,
            _CODE[batch.payload.dtype],
            batch.payload.shape[1],
            _plain(batch.source, _INT),
            np.ascontiguousarray(batch.payload),
            b"" if batch.links is None else _plain(batch.links, _INT),
        )
        for batch in frames
    ]


def _read(raw: bytes, kind: int, into: Floats | None, uavs: int = 0) -> Message:
    """Read the parts of a message of a kind; raises MessageRejected for the reason that `kernels.read` gives."""
    try:
        return kernels.read(raw, kind, into, uavs)
    except ValueError as error:
        reason, _, detail = str(error).partition(": ")
        raise MessageRejected(reason, detail) from error


def bytes_of_batch(frames: Frames) -> int:
    """Bytes of a batch without links in a message."""
    return _BATCH_BYTES + frames.source.size * _INT.itemsize + frames.payload.nbytes


def _plain(array: np.ndarray, dtype: np.dtype = _FLOAT) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=dtype)


_BATCH_BYTES = len(kernels.write(SENSE, 0, 0, 0, 0, 0, b"", (b"",), [(0, 0, 0, 0, b"", b"", b"")])) - len(
    kernels.write(SENSE, 0, 0, 0, 0, 0, b"", (b"",))
)
