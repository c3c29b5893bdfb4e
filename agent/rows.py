"""A controller's memory and results, row by row: checked, taken apart and put together again."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.swarm.ascending import distinct
from meanflock.swarm.declared import MAX_BROADCASTS, Declared
from meanflock.swarm.failures import FAILURES
from meanflock.swarm.kept import check_again
from meanflock.swarm.state import AXES, Floats, Mask
from meanflock.swarm.wire.messages import NOBODY

Answer = TypeVar("Answer")

SENT = (np.dtype("i1"), np.dtype("u1"), np.dtype("<i2"), np.dtype("<i4"))  # integers that travel


def checked_table(name: str, table: Floats, rows: int, width: int) -> Floats:
    """`table` itself as finite floats, (rows, width).

    Raises:
        TypeError, ValueError: it is something else.
    """
    if np.shape(table) != (rows, width):
        raise ValueError(f"`{name}` returns shape {np.shape(table)}; expected {(rows, width)}")
    numbers = np.ascontiguousarray(_as_floats(table))
    if not np.isfinite(numbers).all():
        raise ValueError(f"`{name}` returns numbers that are not finite")
    return numbers


def checked_step(step: Step, before: Memory, blank: Floats, declared: Declared, uavs: int) -> tuple[Floats, float]:
    """The commands of a step from the memory `before`: accelerations, then diagnostics, in an array like `blank`
    (M, 2 + K); and the largest |number| of them, NaN where one is. uavs: of the swarm.

    Raises:
        TypeError, ValueError: something of it has not the shape it must have.
    """
    commands = blank.copy()
    try:
        largest = kernels.columns(step.acceleration, step.diagnostics, commands, AXES)
    except (AttributeError, TypeError, ValueError):  # numbers of another dtype, or of another shape
        if not isinstance(step, Step):
            raise TypeError(f"`step` returns a {type(step).__name__}; expected mf.Step(memory, acceleration)") from None
        largest = kernels.columns(*_tables(step, len(blank), declared), commands, AXES)
    check_again("memory", step.memory, before)
    if step.broadcasts:
        _check_broadcasts(step.broadcasts, len(blank), declared)
    if len(step.refused):
        _check_refused(step.refused, uavs)
    return commands, largest


def _as_floats(numbers: Floats) -> Floats:
    """Numbers as float64; complex ones are refused, and do not lose their imaginary part in silence."""
    return np.asarray(numbers).astype(np.float64, casting="same_kind", copy=False)


def _check_refused(refused: object, uavs: int) -> None:
    if not (isinstance(refused, np.ndarray) and refused.ndim == 1 and refused.dtype.kind == "i"):
        raise TypeError("`refused` is no array of numbers of UAVs")
    if refused.min() < 0 or refused.max() >= uavs:
        raise ValueError(f"`refused` names UAVs from {refused.min()} to {refused.max()}; there are 0 … {uavs - 1}")


def _tables(step: Step, rows: int, declared: Declared) -> tuple[Floats, Floats]:
    """The accelerations and diagnostics of a step as float64, or the error that says what is wrong with them."""
    acceleration, columns = _as_floats(step.acceleration), len(declared.diagnostics)
    if acceleration.shape != (rows, AXES):
        raise ValueError(f"acceleration has shape {acceleration.shape}; expected {(rows, AXES)}")
    if step.diagnostics is None and columns:
        raise ValueError(f"no diagnostics; expected shape {(rows, columns)}")
    diagnostics = np.zeros((rows, 0)) if step.diagnostics is None else _as_floats(step.diagnostics)
    if diagnostics.shape != (rows, columns):
        raise ValueError(f"diagnostics have shape {diagnostics.shape}; expected {(rows, columns)}")
    return acceleration, diagnostics


def _check_broadcasts(broadcasts: Sequence[Broadcast], rows: int, declared: Declared) -> None:
    if not isinstance(broadcasts, (tuple, list)) or not all(isinstance(one, Broadcast) for one in broadcasts):
        raise TypeError("`broadcasts` must be a tuple or list of mf.Broadcast")
    if len(broadcasts) > MAX_BROADCASTS:
        raise ValueError(f"{len(broadcasts)} broadcasts; at most {MAX_BROADCASTS} in a tick")
    for broadcast in broadcasts:
        _check_broadcast(broadcast, rows)
    if (said := sum(broadcast.payload.shape[1] for broadcast in broadcasts)) > declared.broadcast_numbers:
        raise ValueError(f"{said} numbers broadcast; `broadcast_numbers` declares {declared.broadcast_numbers}")


def _check_broadcast(broadcast: Broadcast, rows: int) -> None:
    said, speaks = broadcast.payload, broadcast.rows
    if not isinstance(said, np.ndarray):
        raise TypeError(f"a broadcast of a {type(said).__name__}; expected an array, a row of numbers for each sender")
    speaking = rows if speaks is None else len(speaks)
    if said.ndim != 2 or len(said) != speaking or not said.shape[1]:
        raise ValueError(f"a broadcast has shape {said.shape}; expected ({speaking}, 1 …)")
    if said.dtype.kind != "f" and said.dtype not in SENT:
        raise TypeError(f"a broadcast of {said.dtype}; expected floats, int8, uint8, int16 or int32")
    if speaks is not None and not (
        isinstance(speaks, np.ndarray)
        and speaks.dtype.kind == "i"
        and speaks.ndim == 1
        and (not len(speaks) or (speaks[0] >= 0 and speaks[-1] < rows and (np.diff(speaks) > 0).all()))
    ):
        raise ValueError(f"a broadcast of rows {speaks!r}; expected an array of some of 0 … {rows - 1}, ascending")


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


def each_alone(rows: Iterable[int], ask: Callable[[int], Answer]) -> dict[int, Answer]:
    """What is answered for every row by itself, after it failed for all together; rows that fail alone are left out."""
    answers = {}
    for row in rows:
        with suppress(*FAILURES):
            answers[row] = ask(row)
    return answers


def put(memory: Memory, alone: Mapping[int, Memory]) -> Memory:
    """A memory with that of some rows, each by itself."""
    after = {name: array.copy() for name, array in memory.items()}
    for row, of in alone.items():
        for name, array in of.items():
            after[name][row] = array[0]
    return after


def step_each_alone(
    controller: Controller,
    memory: Memory,
    tick: int,
    own: Floats,
    received: Sequence[Received],
    declared: Declared,
    uavs: int,
) -> tuple[Step, Floats]:
    """The step of every row by itself. Of rows that fail the memory is as it was, and the commands are NaN."""
    columns = AXES + len(declared.diagnostics)
    commands = np.full((len(own), columns), np.nan)
    said: dict[int, dict[int, NDArray[np.generic]]] = {}  # by number and row

    def ask(row: int) -> Step:
        alone = row_of(memory, row)
        step = controller.step(alone, tick, own[row : row + 1], of_row(received, row))
        numbers, _ = checked_step(step, alone, np.zeros((1, columns)), declared, uavs)
        payloads = {number: broadcast.payload for number, broadcast in enumerate(step.broadcasts)}
        for number, payload in payloads.items():
            first = next(iter(said.get(number, {}).values()), payload)
            if len(payload) and (payload.shape, payload.dtype) != (first.shape, first.dtype):
                raise ValueError(f"broadcast {number} is unlike that of other rows")
        for number, payload in payloads.items():
            of_number = said.setdefault(number, {})  # those that nobody sends too: their place is their number
            if len(payload):
                of_number[row] = payload
        commands[row] = numbers
        return step

    steps = each_alone(range(len(own)), ask)
    silence = [np.zeros((0, 1))]
    broadcasts = tuple(
        Broadcast(np.concatenate([*payloads.values()] or silence), np.array([*payloads], dtype=np.intp))
        for _, payloads in sorted(said.items())
    )
    after = put(memory, {row: step.memory for row, step in steps.items()})
    refused = distinct(np.concatenate([NOBODY, *(step.refused for step in steps.values())])).astype(np.int32)
    return Step(after, commands[:, :AXES], commands[:, AXES:], broadcasts, refused), commands
