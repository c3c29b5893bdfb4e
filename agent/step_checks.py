"""Checks of what a controller returns, which may be foreign code."""

from collections.abc import Sequence

import numpy as np

from meanflock import kernels
from meanflock.agent.controllers.base import Broadcast, Memory, Rows, Step
from meanflock.swarm.declared import MAX_BROADCASTS, Declared
from meanflock.swarm.plugins.guard import as_floats, check_same_form
from meanflock.swarm.state import Floats

SENT = (np.dtype("i1"), np.dtype("u1"), np.dtype("<i2"), np.dtype("<i4"))  # integers that a broadcast may have


def checked_step(step: Step, before: Memory, blank: Floats, declared: Declared, uavs: int) -> tuple[Floats, float]:
    """Check a step from the memory `before`, and return its commands and the largest |number| of them, NaN if one is.

    Args:
        blank: (M, 2 + K), an array like the commands: accelerations, then diagnostics. uavs: number in the swarm.

    Raises:
        TypeError, ValueError: a part of the step has a wrong type, shape or value.
    """
    commands, axes = blank.copy(), blank.shape[1] - len(declared.diagnostics)
    try:
        largest = kernels.columns(step.acceleration, step.diagnostics, commands, axes)
    except (AttributeError, TypeError, ValueError):  # numbers of another dtype, or of another shape
        if not isinstance(step, Step):
            raise TypeError(f"`step` returns a {type(step).__name__}; expected mf.Step(memory, acceleration)") from None
        largest = kernels.columns(*_tables(step, (len(blank), axes), declared), commands, axes)
    check_same_form("memory", step.memory, before)
    check_broadcasts(step.broadcasts, len(blank), declared)
    if len(step.refused):
        _check_refused(step.refused, uavs)
    return commands, largest


def _check_refused(refused: object, uavs: int) -> None:
    if not (isinstance(refused, np.ndarray) and refused.ndim == 1 and refused.dtype.kind == "i"):
        raise TypeError("`refused` is no array of numbers of UAVs")
    if refused.min() < 0 or refused.max() >= uavs:
        raise ValueError(f"`refused` names UAVs from {refused.min()} to {refused.max()}; there are 0 … {uavs - 1}")


def _tables(step: Step, shape: tuple[int, int], declared: Declared) -> tuple[Floats, Floats]:
    """The accelerations and diagnostics of a step as float64, or the error that says what is wrong with them."""
    rows, columns = shape[0], len(declared.diagnostics)
    acceleration = as_floats("acceleration", step.acceleration, shape)
    if step.diagnostics is None and columns:
        raise ValueError(f"no diagnostics; expected shape {(rows, columns)}")
    diagnostics = np.zeros((rows, 0)) if step.diagnostics is None else step.diagnostics
    return acceleration, as_floats("table of diagnostics", diagnostics, (rows, columns))


def check_broadcasts(broadcasts: Sequence[Broadcast], rows: int, declared: Declared) -> None:
    """Check the broadcasts of a step of so many rows.

    Raises:
        TypeError, ValueError: they have a wrong type or shape, or more numbers than declared.
    """
    if not isinstance(broadcasts, (tuple, list)) or not all(isinstance(one, Broadcast) for one in broadcasts):
        raise TypeError("`broadcasts` must be a tuple or list of mf.Broadcast")
    if len(broadcasts) > MAX_BROADCASTS:
        raise ValueError(f"{len(broadcasts)} broadcasts; at most {MAX_BROADCASTS} in a tick")
    for broadcast in broadcasts:
        _check_broadcast(broadcast.payload, broadcast.rows, rows)
    numbers = sum(broadcast.payload.shape[1] for broadcast in broadcasts)
    if numbers > declared.broadcast_numbers:
        raise ValueError(f"{numbers} numbers broadcast; `broadcast_numbers` declares {declared.broadcast_numbers}")


def _check_broadcast(payload: object, senders: Rows | None, rows: int) -> None:
    if not isinstance(payload, np.ndarray):
        payload_type = type(payload).__name__
        raise TypeError(f"a broadcast of a {payload_type}; expected an array, a row of numbers for each sender")
    count = rows if senders is None else len(senders)
    if payload.ndim != 2 or len(payload) != count or not payload.shape[1]:
        raise ValueError(f"a broadcast has shape {payload.shape}; expected ({count}, 1 …)")
    if payload.dtype.kind != "f" and payload.dtype not in SENT:
        raise TypeError(f"a broadcast of {payload.dtype}; expected floats, int8, uint8, int16 or int32")
    if senders is not None and not (
        isinstance(senders, np.ndarray)
        and senders.dtype.kind == "i"
        and senders.ndim == 1
        and (not len(senders) or (senders[0] >= 0 and senders[-1] < rows and (senders[1:] > senders[:-1]).all()))
    ):
        raise ValueError(f"a broadcast of rows {senders!r}; expected an array of some of 0 … {rows - 1}, ascending")


def check_notes(notes: object, rows: int, most: int) -> None:
    """Check the notes of so many rows.

    Raises:
        TypeError, ValueError: they are not a list of bytes for each row, or one is longer than declared.
    """
    if not isinstance(notes, (tuple, list)) or not all(isinstance(note, bytes) for note in notes):
        raise TypeError("`note` must return a list of bytes, one for each row")
    if len(notes) != rows:
        raise ValueError(f"`note` returns {len(notes)} notes; expected {rows}, one for each row")
    if (longest := max(map(len, notes), default=0)) > most:
        raise ValueError(f"`note` returns {longest} bytes; `note_bytes` declares {most}")
