"""Messages that are almost ones: bytes flipped, cut, spliced, and fields replaced inside a valid envelope."""

import random
import struct
from collections.abc import Sequence
from typing import Any

import msgspec

Ext = msgspec.msgpack.Ext

_TELLING_BYTES = bytes((0x00, 0x01, 0x7F, 0x80, 0x8F, 0x90, 0xC0, 0xC1, 0xC4, 0xC7, 0xCB, 0xD4, 0xDC, 0xDD, 0xDF, 0xFF))
_TELLING_INTS = (0, 1, 2, 5, 6, 20, 21, -1, 255, 2**15, 2**31 - 1, 2**31, 2**32, 2**63 - 1, 2**64 - 1, -(2**63))
_TELLING_TEXTS = ("", "sense", "act", "ready", "agent", "leader", "station", "\N{SNOWMAN}" * 9)
_TELLING_VALUES: tuple[Any, ...] = (None, True, 7, 2**64 - 1, 0.0, 1e308, float("nan"), "telemetry", b"", b"\xff" * 40)
_TELLING_VALUES += ([], {}, [[]], [0] * 40, {"a": 1})
_TELLING_VALUES += tuple(
    Ext(code, data) for code in (1, 2, -1) for data in (b"", b"\2\0" + bytes(8), b"\2\2" + bytes(8))
)
_TELLING_FLOATS = tuple(struct.pack("<d", x) for x in (float("nan"), float("inf"), 1e300, -1e300, 5e-324, 1e9, -0.0))
_OF_A_TICK = (1, 2)  # types of a Sense and an Act, see docs/wire.md
_DEPTHS = (1, 1, 1, 2, 3)  # mutations on top of each other


def laid_out(tree: list[Any]) -> bytes:
    """The bytes of a message of a tick, of the numbers and byte strings in `tree`, as docs/wire.md says.

    Raises:
        struct.error, TypeError, ValueError, AttributeError: they are not such numbers and byte strings.
    """
    kind, run, tick, flags, rows, columns, *tables, frames = tree
    head = struct.pack(">BBBIBIBBIB", 0x90 | len(tree), kind, 0xCE, run, 0xCE, tick, flags, 0xCE, rows, columns)
    parts = [head, *map(_bytes, tables), struct.pack(">BH", 0xDC, len(frames))]
    for label, number, code, width, source, payload, links in frames:
        parts.append(struct.pack(">BBBIBBI", 0x97, label, 0xCE, number, code, 0xCE, width))
        parts += map(_bytes, (source, payload, links))
    return b"".join(parts)


def _bytes(value: bytes) -> bytes:
    return struct.pack(">BI", 0xC6, len(value)) + value.ljust(0)  # of a list there is no ljust


class Mutator:
    """An endless stream of mutations of `corpus`, the same for the same seed."""

    def __init__(self, corpus: Sequence[bytes], seed: int) -> None:
        self._corpus = list(corpus)
        self._trees = [msgspec.msgpack.decode(raw) for raw in corpus]
        self._draw = random.Random(seed)

    def __call__(self, tick: int) -> bytes:
        """The next one; those of a tick are of this one, before they are mutated."""
        draw = self._draw
        index = draw.randrange(len(self._corpus))
        if draw.random() < 0.7:  # valid msgpack: what comes after the parser is reached only so
            tree = self._trees[index]
            if tree[0] in _OF_A_TICK:
                tree = [*tree[:2], tick, *tree[3:]]
            for _ in range(draw.choice(_DEPTHS)):
                tree = self._within(tree)
            try:
                return laid_out(tree)
            except (struct.error, TypeError, ValueError, AttributeError):
                pass  # not in the layout of a tick, but MessagePack still
            try:
                return msgspec.msgpack.encode(tree)
            except (OverflowError, ValueError):  # an extension code beyond a byte
                return self._corpus[index]
        raw = self._corpus[index]
        for _ in range(draw.choice(_DEPTHS)):
            raw = self._damaged(raw)
        return raw

    def _within(self, value: Any) -> Any:
        """The value with one change, somewhere within."""
        draw = self._draw
        if draw.random() < 0.1:
            return draw.choice(_TELLING_VALUES)
        match value:
            case list() if value:
                at, how = draw.randrange(len(value)), draw.randrange(16)
                other = draw.choice(draw.choice(self._trees)) if how == 0 else value[at]
                changes = {0: [other], 1: [], 2: [value[at], value[at]]}
                middle = changes[how] if how in changes else [self._within(value[at])]
                return [*value[:at], *middle, *value[at + 1 :]]
            case bytes() if len(value) >= 8 and draw.random() < 0.5:  # other numbers in a table of as many
                at = 8 * draw.randrange(len(value) // 8)
                return value[:at] + draw.choice(_TELLING_FLOATS) + value[at + 8 :]
            case bytes() if value:
                return self._damaged(value)
            case int():
                near = max(-(2**63), min(2**64 - 1, value + draw.choice((-2, -1, 1, 2, 20, 256))))
                return draw.choice((near, near, *_TELLING_INTS))
            case str():
                return draw.choice(_TELLING_TEXTS)
            case _:
                return draw.choice(_TELLING_VALUES)

    def _damaged(self, raw: bytes) -> bytes:
        """The bytes with one change: a span cut, inserted or repeated, spliced with another message, or a byte."""
        draw, other = self._draw, self._draw.choice(self._corpus)
        start = draw.randint(0, len(raw))
        end = min(len(raw), start + draw.randint(0, 16))
        spans = (
            raw[end:],
            draw.randbytes(16) + raw[start:],
            raw[max(0, start - 16) :],
            b"",
            other[draw.randint(0, len(other)) :],
        )
        if not raw or draw.randrange(7) < len(spans):
            return raw[:start] + draw.choice(spans)
        # The first bytes say what follows: half of the changes are there.
        at = draw.randrange(min(len(raw), 48) if draw.random() < 0.5 else len(raw))
        byte = draw.choice((raw[at] ^ (1 << draw.randrange(8)), draw.choice(_TELLING_BYTES)))
        return raw[:at] + bytes([byte]) + raw[at + 1 :]
