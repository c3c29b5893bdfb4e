"""Plain messages: a node's Senses and Acts that bring and say nothing but what most ticks are made of.

Between rounds that is states, and what the node does; every so often an Act also reports the models it learned. A round
adds two: the Act that uploads models, and the Sense that brings the global one. Messages of a kind differ in the tick,
in the round and in the numbers of their arrays, so they are told from all others by their bytes, and read and written
without taking them apart: most of what a message costs among many processes is code and data that the others have
pushed out of the caches. Nothing depends on it: what is not plain, or says the same in other bytes, goes through the
codec.
"""

from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from swarm import codec, model, state
from swarm.messages import OUTCOME_FLOATS, Act, FrameKind, Frames, Message, Sense

Layout: TypeAlias = tuple[tuple[int, ...], np.dtype[Any]]  # shape and dtype of an array
Template: TypeAlias = tuple[bytes | int, ...]  # a text, a gap, …, a text

TICK, NUMBER = 0, 1  # gaps for the tick, and for the number of the round

_CHORUS_LINKS = 5000  # of so many about two are lost in a tick on the paper's radio

_FLOAT, _INDEX = np.dtype("<f8"), np.dtype("<i4")
_whole_number = msgspec.msgpack.Encoder().encode


class Plain:
    """The messages of one kind, with arrays of fixed layouts."""

    def __init__(self, make: Callable[..., Message], *layouts: Layout, of_round: bool = False) -> None:
        """`make`: such a message, of a tick, of the number of a round if it is `of_round`, and of arrays of these
        layouts, none of them empty; all in the order in which they travel, and arrays between the two numbers.
        """
        arrays = [np.zeros(shape, dtype) for shape, dtype in layouts]
        numbers = 1 + of_round
        parts: list[Any] = [*[0] * numbers, *arrays]
        first = codec.encode(make(*parts))

        def place(of: int, other: Any) -> int:
            return _difference(first, codec.encode(make(*parts[:of], other, *parts[of + 1 :])))

        gaps = [(place(k, 1), 1, True) for k in range(numbers)]
        for k, array in enumerate(arrays, numbers):
            ones = np.frombuffer(b"\1" * array.nbytes, array.dtype).reshape(array.shape)
            gaps.append((place(k, ones), array.nbytes, False))
        pieces: list[list[bytes]] = [[]]  # before, between and after the arrays; in two where a number is in it
        end = 0
        for start, size, is_number in sorted(gaps):
            pieces[-1].append(first[end:start])
            end = start + size
            if not is_number:
                pieces.append([])
        pieces[-1].append(first[end:])
        (self._before, self._between), *self._pieces = pieces  # the tick comes first of all
        self._rest = None if of_round else tuple([piece for (piece,) in self._pieces])
        self._arrays = [(shape, dtype, array.nbytes) for (shape, dtype), array in zip(layouts, arrays, strict=True)]
        self.arrays = len(arrays)  # how many there are
        self.size = len(first) - numbers  # in bytes, without the tick and the number of the round
        self.sizes = tuple([array.nbytes for array in arrays])
        self.formats = "".join([array.dtype.char for array in arrays]).encode()  # as `struct` has them
        self._of = -1, 0
        self._frame: tuple[bytes, ...] = ()

    def template(self, *gaps: int | bytes) -> Template:
        """The texts of such messages and the gaps between them: TICK, NUMBER and, for each array, what its gap is
        called, or its bytes where they are known: then they are text."""
        parts: list[int | bytes] = [self._before, TICK, self._between]
        for gap, (first, *others) in zip(gaps, self._pieces, strict=True):
            parts += gap, first
            for text in others:
                parts += NUMBER, text
        template: list[int | bytes] = []
        for part in parts:
            if template and isinstance(part, bytes) and isinstance(last := template[-1], bytes):
                template[-1] = last + part
            else:
                template.append(part)
        return tuple(template)

    def frame(self, tick: int, number: int = 0) -> tuple[bytes, ...]:
        """What comes before, between and after the arrays of a message of that tick, and of that round."""
        if self._of != (tick, number):
            if (rest := self._rest) is None:
                said = _whole_number(number)
                rest = tuple([said.join(piece) for piece in self._pieces])
            before = self._before + _whole_number(tick) + self._between
            self._of, self._frame = (tick, number), (before, *rest)
        return self._frame

    def encode(self, tick: int, *arrays: NDArray[Any], number: int = 0) -> bytes:
        """What the codec makes of the message of a tick with these arrays, which have the layouts."""
        before, *rest = self.frame(tick, number)
        parts = [before]
        for array, after in zip(arrays, rest, strict=True):
            parts += array.tobytes(), after
        return b"".join(parts)

    def decode(self, tick: int, raw: bytes, number: int = 0) -> list[NDArray[Any]] | None:
        """The arrays, their floats finite, if these are the bytes of such a message of that tick; or None."""
        frame, place, arrays = self.frame(tick, number), 0, []
        if len(raw) != sum(self.sizes) + sum(map(len, frame)):
            return None
        for piece, (shape, dtype, size) in zip(frame, self._arrays, strict=False):
            if not raw.startswith(piece, place):
                return None
            place += len(piece)
            arrays.append(np.ndarray(shape, dtype, raw, place))
            place += size
        if not raw.endswith(frame[-1]):
            return None
        return arrays if all(codec.finite(array) for array in arrays if array.dtype.kind == "f") else None

    def split(self, tick: int, raw: bytes, number: int = 0) -> tuple[bytes, ...] | None:
        """The bytes of those arrays."""
        arrays = self.decode(tick, raw, number)
        return None if arrays is None else tuple([array.tobytes() for array in arrays])


@cache
def senses(run: int, rows: int, report: bool = False) -> Plain:
    """Senses of a run for a node of so many UAVs: states (rows, 4). `report`: those that want the models."""
    return Plain(lambda tick, states: Sense(run, tick, states, report), ((rows, state.SIZE), _FLOAT))


@cache
def hearings(run: int, rows: int, report: bool, payload: Layout) -> Plain:
    """Senses that bring the global model of a round to every UAV of a node: states, source (1,), payload (1, …) as it
    is transmitted, links (rows, 2)."""

    def make(tick: int, number: int, states: Any, source: Any, payload: Any, links: Any) -> Message:
        return Sense(run, tick, states, report, (Frames(FrameKind.GLOBAL, number, source, payload, links),))

    layouts = ((rows, state.SIZE), _FLOAT), ((1,), _INDEX), payload, ((rows, 2), _INDEX)
    return Plain(make, *layouts, of_round=True)


@cache
def acts(run: int, rows: int, report: bool = False) -> Plain:
    """Acts of a run of a node of so many UAVs: outcome (rows, 5); with a report the models, (rows, 246), too."""
    outcome, models = ((rows, OUTCOME_FLOATS), _FLOAT), ((rows, model.MODEL_FLOATS), _FLOAT)
    if report:
        return Plain(lambda tick, outcome, models: Act(run, tick, outcome, report=models), outcome, models)
    return Plain(lambda tick, outcome: Act(run, tick, outcome), outcome)


def chorus_links(rows: int, heard: int) -> tuple[int, ...]:
    """How many links a chorus has to a node of so many UAVs that hears so many: all, or all but one.

    Other numbers are not worth a kind of their own: it is made by writing such messages, and of many links more get
    lost in every tick, and never as many as in the last.
    """
    links = rows * (heard - (rows > 1))
    if not 0 < links <= _CHORUS_LINKS:
        return ()
    return (links, links - 1) if rows > 1 else (links,)  # who loses the only link is not heard


@lru_cache(maxsize=256)  # by who is heard: as a rule everyone, and few kinds
def choruses(run: int, rows: int, report: bool, payload: Layout, links: int) -> Plain:
    """Senses that bring states by radio: states, source (S,), payload (S, 4) as it is transmitted, links (K, 2), of
    which there are so many."""

    def make(tick: int, states: Any, source: Any, payload: Any, links: Any) -> Message:
        return Sense(run, tick, states, report, (Frames(FrameKind.STATE, 0, source, payload, links),))

    return Plain(make, ((rows, state.SIZE), _FLOAT), (payload[0][:1], _INDEX), payload, ((links, 2), _INDEX))


@cache
def broadcasts(run: int, rows: int, report: bool, payload: Layout) -> Plain:
    """Acts that broadcast states: outcome, source (S,), payload (S, 4) as it is transmitted; with a report the models,
    too."""

    def make(tick: int, outcome: Any, source: Any, payload: Any, models: Any = None) -> Message:
        return Act(run, tick, outcome, outbox=(Frames(FrameKind.STATE, 0, source, payload),), report=models)

    layouts = ((rows, OUTCOME_FLOATS), _FLOAT), (payload[0][:1], _INDEX), payload
    reported = [((rows, model.MODEL_FLOATS), _FLOAT)] if report else []
    return Plain(make, *layouts, *reported)


@cache
def uploads(run: int, rows: int, report: bool, payload: Layout) -> Plain:
    """Acts that upload models in a round: outcome, source (S,), payload (S, …) as it is transmitted; with a report the
    models, too."""

    def make(tick: int, number: int, outcome: Any, source: Any, payload: Any, models: Any = None) -> Message:
        return Act(run, tick, outcome, outbox=(Frames(FrameKind.UPLOAD, number, source, payload),), report=models)

    layouts = ((rows, OUTCOME_FLOATS), _FLOAT), (payload[0][:1], _INDEX), payload
    reported = [((rows, model.MODEL_FLOATS), _FLOAT)] if report else []
    return Plain(make, *layouts, *reported, of_round=True)


def size_of(number: int) -> int:
    """How many bytes a tick takes, or the number of a round."""
    return len(_whole_number(number))


def encode(sense: Sense) -> bytes:
    """What the codec makes of a Sense; of a plain one, in less time."""
    rows, inbox = len(sense.states), sense.inbox
    if not rows or sense.checkpoint or len(inbox) > 1:
        return codec.encode(sense)
    if not inbox:
        return senses(sense.run, rows, sense.report).encode(sense.tick, sense.states)
    kind, number, source, payload, links = msgspec.structs.astuple(inbox[0])
    if kind == FrameKind.STATE and number == 0 and links is not None and len(links) in chorus_links(rows, len(source)):
        chorus = choruses(sense.run, rows, sense.report, (payload.shape, payload.dtype), len(links))
        return chorus.encode(sense.tick, sense.states, source, payload, links)
    if kind != FrameKind.GLOBAL or len(source) != 1 or links is None or len(links) != rows:
        return codec.encode(sense)
    hearing = hearings(sense.run, rows, sense.report, (payload.shape, payload.dtype))
    return hearing.encode(sense.tick, sense.states, source, payload, links, number=number)


def _difference(one: bytes, other: bytes) -> int:
    """The first place where they differ, which are of one size."""
    return int((np.frombuffer(one, "u1") != np.frombuffer(other, "u1")).argmax())
