"""The two messages of a tick ⇄ bytes of the layout of `kernels/wire.py`.

`kernels.read` checks that a message is well-formed, consistent in its sizes and finite, and that its frames name UAVs
and rows that are there. The receiver checks run, tick and sender.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.kernels.wire import ACT, DTYPES, SENSE, Batch, Message
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
    """Read a Sense; its arrays are read-only.

    Args:
        states: (M, 4), array to which the states are written, which must have this shape; None: none.
        uavs: number of UAVs and stations of the swarm, to check whom the frames name; 0: unchecked.

    Raises:
        MessageRejected: `malformed`, `wrong-shape`, `non-finite` or `wrong-kind`.
    """
    _, run, tick, flags, rows, columns, table, (memory,), batches = _read(raw, SENSE, states, uavs)
    if flags & ~(REPORT | CHECKPOINT):
        raise MessageRejected("malformed", f"flags {flags:#x} of a Sense")
    if states is None:
        states = np.ndarray((rows, columns), _FLOAT, table)
    inbox = frames_in(batches) if batches else ()
    return Sense(run, tick, states, bool(flags & REPORT), bool(flags & CHECKPOINT), inbox, memory)


def read_act(raw: bytes, commands: Floats | None = None) -> Act:
    """Read an Act; its arrays are read-only.

    Args:
        commands: (M, 2 + K), array to which the commands are written, which must have this shape; None: none.

    Raises:
        MessageRejected: `malformed`, `wrong-shape`, `non-finite` or `wrong-kind`.
    """
    _, run, tick, flags, rows, columns, table, others, batches = _read(raw, ACT, commands)
    lost, refused_uploads, refused_states, waiting, models, memory = others
    if flags:
        raise MessageRejected("malformed", f"flags {flags:#x} of an Act")
    if commands is None:
        commands = np.ndarray((rows, columns), _FLOAT, table)
    width, left = divmod(len(models) // _FLOAT.itemsize, rows) if rows else (0, len(models))
    if left:
        raise MessageRejected("wrong-shape", f"{len(models)} bytes of models of {rows} UAVs")
    return Act(
        run,
        tick,
        commands,
        _uavs_in(lost),
        _uavs_in(refused_uploads),
        _uavs_in(refused_states),
        _uavs_in(waiting),
        np.ndarray((rows, width), _FLOAT, models) if models else None,
        memory,
        frames_in(batches) if batches else (),
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
    named = (_uavs_out(uavs) for uavs in (act.lost, act.refused_uploads, act.refused_states, act.waiting))
    tables = *named, b"" if act.models is None else _plain(act.models), act.memory
    outbox = frames_out(act.outbox) if act.outbox else ()
    return kernels.write(ACT, act.run, act.tick, 0, rows, columns, _plain(act.commands), tables, outbox)


def frames_in(batches: Iterable[Batch]) -> tuple[Frames, ...]:
    """The batches of a message that was read.

    Raises:
        MessageRejected: `wrong-kind`: the kind of a batch is unknown.
    """
    frames = []
    for kind, number, code, width, source, payload, links in batches:
        if kind >= len(_KINDS):
            raise MessageRejected("wrong-kind", f"frames of kind {kind}")
        named = np.frombuffer(source, _INT)
        sent = np.ndarray((len(named), width), _DTYPES[code], payload)
        pairs = np.frombuffer(links, _INT).reshape(-1, 2) if links else None
        frames.append(Frames(_KINDS[kind], number, named, sent, pairs))
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


def _uavs_in(raw: bytes) -> NDArray[np.int32]:
    return np.frombuffer(raw, _INT) if raw else NOBODY


def _uavs_out(uavs: NDArray[np.integer]) -> NDArray[np.integer]:
    return uavs if uavs is NOBODY else _plain(uavs, _INT)


def _read(raw: bytes, kind: int, into: Floats | None, uavs: int = 0) -> Message:
    """Read the parts of a message of a kind; raises MessageRejected for the reason that `kernels.read` gives."""
    try:
        return kernels.read(raw, kind, into, uavs)
    except ValueError as error:
        reason, _, detail = str(error).partition(": ")
        raise MessageRejected(reason, detail) from error


def _plain(array: np.ndarray, dtype: np.dtype = _FLOAT) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=dtype)
