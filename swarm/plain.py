"""Plain messages: a node's Senses that bring nothing but states, and its Acts that say nothing but what it does.

Between rounds a swarm says nothing else; every so often an Act also reports the models it learned. Two plain messages
differ in the tick and in the numbers of their arrays, so they are told from all others by their bytes, and read and
written without taking them apart: most of what a message costs among many processes is code and data that the others
have pushed out of the caches. Nothing depends on it: what is not plain, or says the same in other bytes, goes through
the codec.
"""

from collections.abc import Callable
from functools import cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from swarm import codec, model, state
from swarm.messages import OUTCOME_FLOATS, Act, Message, Sense

Floats = NDArray[np.float64]

_whole_number = msgspec.msgpack.Encoder().encode


class Plain:
    """The messages of one kind for so many rows."""

    def __init__(self, make: Callable[..., Message], *shapes: tuple[int, ...]) -> None:
        """`make`: such a message, of a tick and arrays of these shapes, none of them empty."""
        zeros = [np.zeros(shape) for shape in shapes]
        first = codec.encode(make(0, *zeros))
        start = _difference(first, codec.encode(make(1, *zeros)))
        self._shapes, self._before, pieces = shapes, first[:start], []
        start += 1  # the tick, here of one byte
        for k, array in enumerate(zeros):
            ones = np.frombuffer(b"\1" * array.nbytes).reshape(array.shape)
            here = _difference(first, codec.encode(make(0, *zeros[:k], ones, *zeros[k + 1 :])))
            pieces.append(first[start:here])
            start = here + array.nbytes
        self._pieces = (*pieces, first[start:])
        self._rest = len(first) - len(self._before) - 1 - len(pieces[0])  # of the length, from the first array on
        self._tick = -1
        self._frame: tuple[bytes, ...] = ()

    def frame(self, tick: int) -> tuple[bytes, ...]:
        """What comes before, between and after the arrays of a message of that tick."""
        if self._tick != tick:
            between, *rest = self._pieces
            self._tick, self._frame = tick, (self._before + _whole_number(tick) + between, *rest)
        return self._frame

    def encode(self, tick: int, array: Floats) -> bytes:
        """What the codec makes of the message of a tick with this array, of the shape, where there is but one."""
        before, after = self.frame(tick)
        return before + array.tobytes() + after

    def decode(self, tick: int, raw: bytes) -> list[Floats] | None:
        """The arrays, finite and of the shapes, if these are the bytes of such a message of that tick; or None."""
        frame, place, arrays = self.frame(tick), 0, []
        if len(raw) != len(frame[0]) + self._rest:
            return None
        for piece, shape in zip(frame, self._shapes, strict=False):
            if not raw.startswith(piece, place):
                return None
            place += len(piece)
            arrays.append(np.ndarray(shape, np.float64, raw, place))
            place += arrays[-1].nbytes
        return arrays if raw.endswith(frame[-1]) and all(map(codec.finite, arrays)) else None


@cache
def senses(run: int, rows: int, report: bool = False) -> Plain:
    """Senses of a run for a node of so many UAVs: states (rows, 4). `report`: those that want the models."""
    return Plain(lambda tick, states: Sense(run, tick, states, report), (rows, state.SIZE))


@cache
def acts(run: int, rows: int, report: bool = False) -> Plain:
    """Acts of a run of a node of so many UAVs: outcome (rows, 5); with a report the models, (rows, 246), too."""
    outcome, models = (rows, OUTCOME_FLOATS), (rows, model.MODEL_FLOATS)
    if report:
        return Plain(lambda tick, outcome, models: Act(run, tick, outcome, report=models), outcome, models)
    return Plain(lambda tick, outcome: Act(run, tick, outcome), outcome)


def encode(sense: Sense) -> bytes:
    """What the codec makes of a Sense; of a plain one, in less time."""
    if sense.inbox or sense.checkpoint or not len(sense.states):
        return codec.encode(sense)
    return senses(sense.run, len(sense.states), sense.report).encode(sense.tick, sense.states)


def decode(raw: bytes, run: int, tick: int, rows: int) -> Act | None:
    """A plain Act of that run and tick, its numbers finite and of so many rows; None for whatever else this is."""
    if rows:
        for report in (False, True):
            if (arrays := acts(run, rows, report).decode(tick, raw)) is not None:
                return Act(run, tick, arrays[0], report=arrays[1] if report else None)
    return None


def _difference(one: bytes, other: bytes) -> int:
    """The first place where they differ."""
    return next(k for k, (a, b) in enumerate(zip(one, other, strict=True)) if a != b)
