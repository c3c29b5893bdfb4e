"""Plain messages: a node's Senses that bring nothing but states, and its Acts that say nothing but what it does.

Between rounds and reports a swarm says nothing else. Two of them differ in the tick and in the numbers of one array, so
they are told from all others by their bytes, and read and written without taking them apart: most of what a message
costs among many processes is code and data that the others have pushed out of the caches. Nothing depends on it: what
is not plain, or says the same in other bytes, is the codec's.
"""

from collections.abc import Callable
from functools import cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from swarm import codec, state
from swarm.messages import OUTCOME_FLOATS, Act, Message, Sense

Floats = NDArray[np.float64]

_whole_number = msgspec.msgpack.Encoder().encode


class Plain:
    """The messages of one kind for so many rows."""

    def __init__(self, make: Callable[[int, Floats], Message], shape: tuple[int, ...]) -> None:
        """`make`: such a message of a tick, with an array of that shape, not empty."""
        zeros = np.zeros(shape)
        ones = np.frombuffer(b"\1" * zeros.nbytes).reshape(shape)
        first, later, other = (codec.encode(make(*of)) for of in ((0, zeros), (1, zeros), (0, ones)))
        tick, numbers = _difference(first, later), _difference(first, other)
        self._shape, self._count = shape, zeros.size
        self._before, self._between = first[:tick], first[tick + 1 : numbers]
        self._after = first[numbers + zeros.nbytes :]
        self._tick, self._frame = -1, (b"", b"")

    def frame(self, tick: int) -> tuple[bytes, bytes]:
        """What comes before the numbers of a message of that tick, and what after them."""
        if self._tick != tick:
            self._tick, self._frame = tick, (self._before + _whole_number(tick) + self._between, self._after)
        return self._frame

    def encode(self, tick: int, numbers: Floats) -> bytes:
        """What the codec makes of the message of a tick with these numbers, of the shape."""
        before, after = self.frame(tick)
        return before + numbers.tobytes() + after

    def decode(self, tick: int, raw: bytes) -> Floats | None:
        """The numbers, finite and of the shape, if these are the bytes of such a message of that tick; or None."""
        before, after = self.frame(tick)
        if len(raw) != len(before) + 8 * self._count + len(after):
            return None
        if not (raw.startswith(before) and raw.endswith(after)):
            return None
        numbers: Floats = np.ndarray(self._shape, np.float64, raw, len(before))
        return numbers if codec.finite(numbers) else None


@cache
def senses(run: int, rows: int) -> Plain:
    """Senses of a run for a node of so many UAVs: numbers (rows, 4), the states."""
    return Plain(lambda tick, states: Sense(run, tick, states, False), (rows, state.SIZE))


@cache
def acts(run: int, rows: int) -> Plain:
    """Acts of a run of a node of so many UAVs: numbers (rows, 5), the outcome."""
    return Plain(lambda tick, outcome: Act(run, tick, outcome), (rows, OUTCOME_FLOATS))


def encode(sense: Sense) -> bytes:
    """What the codec makes of a Sense; of a plain one, in less time."""
    if sense.report or sense.inbox or sense.checkpoint or not len(sense.states):
        return codec.encode(sense)
    return senses(sense.run, len(sense.states)).encode(sense.tick, sense.states)


def decode(raw: bytes, run: int, tick: int, rows: int) -> Act | None:
    """A plain Act of that run and tick, its numbers finite and of so many rows; None for whatever else this is."""
    outcome = acts(run, rows).decode(tick, raw) if rows else None
    return None if outcome is None else Act(run, tick, outcome)


def _difference(one: bytes, other: bytes) -> int:
    """The first place where they differ."""
    return next(k for k, (a, b) in enumerate(zip(one, other, strict=True)) if a != b)
