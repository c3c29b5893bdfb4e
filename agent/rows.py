"""A controller's memory and results, row by row: checked, taken apart and put together again."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from swarm.state import AXES

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

KEPT = "fiub"  # kinds of arrays that can be checkpointed
SENT = (np.dtype("i1"), np.dtype("u1"), np.dtype("<i2"), np.dtype("<i4"))  # integers that travel


def checked_memory(memory: Memory, rows: int) -> Memory:
    """`memory` itself, if it can be a controller's of so many rows.

    Raises:
        TypeError, ValueError: it cannot; the message names the array, what was expected and what came.
    """
    if not isinstance(memory, dict):
        raise TypeError(f"the memory is a {type(memory).__name__}; expected a dict of arrays")
    for name, array in memory.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in KEPT:
            raise TypeError(f"memory[{name!r}] is no array of numbers")
        if not array.ndim or len(array) != rows:
            raise ValueError(f"memory[{name!r}] has shape {array.shape}; expected a leading axis of {rows} rows")
    return memory


def checked_step(step: Step, rows: int, columns: int) -> Floats:
    """The commands (rows, columns) of a step: accelerations, then diagnostics.

    Raises:
        TypeError, ValueError: something of it has not the shape it must have.
    """
    commands = np.empty((rows, columns))
    acceleration, diagnostics = np.asarray(step.acceleration), step.diagnostics
    if acceleration.shape != (rows, AXES):
        raise ValueError(f"acceleration has shape {acceleration.shape}; expected {(rows, AXES)}")
    commands[:, :AXES] = acceleration
    if diagnostics is None and columns > AXES:
        raise ValueError(f"no diagnostics; expected shape {(rows, columns - AXES)}")
    if diagnostics is not None:
        if np.shape(diagnostics) != (rows, columns - AXES):
            raise ValueError(f"diagnostics have shape {np.shape(diagnostics)}; expected {(rows, columns - AXES)}")
        commands[:, AXES:] = diagnostics
    checked_memory(step.memory, rows)
    for broadcast in step.broadcasts:
        check_broadcast(broadcast, rows)
    return commands


def check_broadcast(broadcast: Broadcast, rows: int) -> None:
    """Raises TypeError or ValueError where a broadcast of some of so many rows cannot be sent."""
    said, speaks = broadcast.payload, broadcast.rows
    speaking = rows if speaks is None else len(speaks)
    if said.ndim != 2 or len(said) != speaking or not said.shape[1]:
        raise ValueError(f"a broadcast has shape {said.shape}; expected ({speaking}, W)")
    if said.dtype.kind != "f" and said.dtype not in SENT:
        raise TypeError(f"a broadcast of {said.dtype}; expected floats, int8, uint8, int16 or int32")
    if (
        speaks is not None
        and len(speaks)
        and not (speaks[0] >= 0 and speaks[-1] < rows and (np.diff(speaks) > 0).all())
    ):
        raise ValueError(f"a broadcast of rows {speaks}; expected some of 0 … {rows - 1}, ascending")


def picked(which: Mask, yes: Memory, no: Memory) -> Memory:
    """The rows `which` (M,) of one memory, all others of another."""
    return {
        name: np.where(which.reshape(-1, *(1,) * (array.ndim - 1)), yes[name], array) if name in yes else array
        for name, array in no.items()
    }


def row_of(memory: Memory, row: int) -> Memory:
    """The memory of one row alone."""
    return {name: array[row : row + 1] for name, array in memory.items()}


def of_row(received: Sequence[Received], row: int) -> tuple[Received, ...]:
    """What one row alone received."""
    own = []
    for frames in received:
        mine = frames.links[frames.links[:, 1] == row]
        if len(mine):
            used, place = np.unique(mine[:, 0], return_inverse=True)
            links = np.stack([place, np.zeros_like(place)], axis=-1)
            own.append(Received(frames.number, frames.source[used], frames.payload[used], links))
    return tuple(own)


def each_alone(
    controller: Controller,
    memory: Memory,
    tick: int,
    own: Floats,
    received: Sequence[Received],
    commands: Floats,
) -> Step:
    """The step of every row by itself, after it failed for all together: only rows that fail alone have failed.

    Their memory is as it was, and their `commands` (M, 2 + K), which are written to, are NaN.
    """
    rows, columns = commands.shape
    after = {name: array.copy() for name, array in memory.items()}
    said: dict[int, list[tuple[int, NDArray[np.generic]]]] = {}
    refused = [np.zeros(0, dtype=np.int32)]
    for row in range(rows):
        try:
            step = controller.step(row_of(memory, row), tick, own[row : row + 1], of_row(received, row))
            commands[row] = checked_step(step, 1, columns)
            for name, array in step.memory.items():
                after[name][row] = array[0]
        except Exception:  # it is among those that failed
            commands[row] = np.nan
            continue
        refused.append(step.refused)
        for number, broadcast in enumerate(step.broadcasts):
            if broadcast.rows is None or len(broadcast.rows):
                said.setdefault(number, []).append((row, broadcast.payload[0]))
    broadcasts = tuple(
        Broadcast(np.stack([payload for _, payload in spoken]), np.array([row for row, _ in spoken]))
        for _, spoken in sorted(said.items())
    )
    return Step(after, commands[:, :AXES], commands[:, AXES:], broadcasts, np.unique(np.concatenate(refused)))
