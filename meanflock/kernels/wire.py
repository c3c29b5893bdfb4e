"""Reader and writer of the layout of tick messages, which `docs/wire.md` describes.

A message is a MessagePack array of small integers, 32-bit integers and byte strings with 32-bit lengths, in a fixed
order. So every offset follows from the numbers before it:

    head    [type, run, tick, flags, rows, columns, table]      24 bytes, then rows × columns float64
    tables  byte strings; how many depends on the type
    frames  an array of batches [kind, round, dtype, width, source, payload, links]

This is the NumPy backend's form; the compiled one has the same signatures.
"""

import struct
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from meanflock.kernels.state import Floats

SENSE, ACT = 1, 2  # types of a message
TABLES = {SENSE: "b", ACT: "iidb"}  # types of the tables after the first: b bytes, i int32, d float64

# Of a batch: kind, round, dtype code, bytes of a row of the payload, sources, offset of these, offset of the payload,
# links, offset of these.
Batch: TypeAlias = tuple[int, int, int, int, int, int, int, int, int]
# Type, run, tick, flags, rows, columns, [offset, bytes] of each table after the first one flat, batches.
Message: TypeAlias = tuple[int, int, int, int, int, int, tuple[int, ...], tuple[Batch, ...]]

FIRST = 24  # offset of the first table; a multiple of eight, so that its numbers are aligned
DTYPES = ("<f2", "<f4", "<f8", "<i4", "u1", "<i2", "i1")
_FLOATS = ("<f2", "<f4", "<f8")
_SIZE = tuple(np.dtype(name).itemsize for name in DTYPES)

_HEAD = struct.Struct(">BBBIBIBBIBBI")
_BYTES = struct.Struct(">BI")
_FRAMES = struct.Struct(">BH")
_BATCH = struct.Struct(">BBBIBBIBI")
_ARRAY = 0x90
_U32 = 0xCE
_BIN32 = 0xC6
_ARRAY16 = 0xDC
_BATCH_ITEMS = 7
_LINK = 8  # bytes: [row of payload, receiving UAV], int32
_NAME = 4  # bytes of a source, int32


def read(raw: bytes, kind: int = 0, into: Floats | None = None, uavs: int = 0, /) -> Message:
    """Read the parts of a message.

    Args:
        kind: the required type; 0 for any. into: (rows, columns), float64, array to which the first table is written
            after all other checks; None: none. uavs: number of all UAVs, by which sources and links of frames are
            checked; 0: unchecked.

    Raises:
        ValueError: another layout, a float that is not finite, frames that name UAVs or rows of their payload that are
            not there, the other type, or a first table of another shape than `into` (any columns if there are no rows).
            The text begins with the reason, `malformed`, `wrong-shape`,
            `non-finite` or `wrong-kind`, and a colon.
    """
    try:
        array, type_, run_, run, tick_, tick, flags, rows_, rows, columns, table_, size = _HEAD.unpack_from(raw)
        follow = TABLES[type_]
        if (
            array != _ARRAY | (8 + len(follow))
            or run_ != _U32
            or tick_ != _U32
            or rows_ != _U32
            or table_ != _BIN32
            or flags > 127
            or columns > 127
        ):
            raise ValueError("malformed: not the head of a tick message")
    except (struct.error, KeyError):
        raise ValueError("malformed: not the head of a tick message") from None
    if size != 8 * rows * columns:
        raise ValueError(f"wrong-shape: {rows} × {columns} numbers in {size} bytes")
    at = FIRST + size
    if at > len(raw):
        raise ValueError("malformed: cut off")
    _check_finite(raw, "<f8", FIRST, size)
    tables: list[int] = []
    for letter in follow:
        at, size = _bytes_at(raw, at)
        if letter == "d":
            _check_finite(raw, "<f8", at, size)
        elif letter == "i" and size % 4:
            raise ValueError(f"wrong-shape: {size} bytes of int32")
        tables += at, size
        at += size
    try:
        mark, count = _FRAMES.unpack_from(raw, at)
    except struct.error:
        raise ValueError("malformed: cut off") from None
    if mark != _ARRAY16:
        raise ValueError("malformed: not an array of frames")
    at += _FRAMES.size
    batches = []
    for _ in range(count):
        batch, at = _read_batch(raw, at, uavs)
        batches.append(batch)
    if at != len(raw):
        raise ValueError("malformed: more than a message")
    if kind and kind != type_:
        raise ValueError("wrong-kind: a message of the other type")
    if into is not None:
        if len(into) != rows or (rows and into.shape[1] != columns):
            raise ValueError("wrong-shape: a first table of other rows or columns than expected")
        into[:] = np.frombuffer(raw, "<f8", into.size, FIRST).reshape(into.shape)
    return type_, run, tick, flags, rows, columns, tuple(tables), tuple(batches)


def write(
    kind: int,
    run: int,
    tick: int,
    flags: int,
    rows: int,
    columns: int,
    table: Any,
    tables: tuple[Any, ...],
    frames: Sequence[tuple[int, int, int, int, Any, Any, Any]] = (),
    /,
) -> bytes:
    """Write a message of these parts; tables and arrays are contiguous little-endian buffers.

    Args:
        table: rows × columns float64. tables: as many as the type has. frames: [kind, round, dtype code, numbers in a
            row of the payload, source, payload, links] of each batch.

    Raises:
        ValueError: a number or a buffer does not fit the layout.
    """
    try:
        follow = TABLES[kind]
        first = bytes(table)
        if len(first) != 8 * rows * columns or len(tables) != len(follow):
            raise ValueError(f"wrong-shape: {rows} × {columns} numbers in {len(first)} bytes, {len(tables)} tables")
        if flags > 127 or columns > 127:
            raise ValueError("wrong-shape: flags and columns are numbers below 128")
        array = _ARRAY | (8 + len(follow))
        parts = [
            _HEAD.pack(array, kind, _U32, run, _U32, tick, flags, _U32, rows, columns, _BIN32, len(first)),
            first,
        ]
        for part in map(bytes, tables):
            parts += _BYTES.pack(_BIN32, len(part)), part
        parts.append(_FRAMES.pack(_ARRAY16, len(frames)))
        for frame_kind, number, code, width, source, payload, links in frames:
            source = bytes(source)
            payload = bytes(payload)
            links = bytes(links)
            named, left = divmod(len(source), _NAME)
            if left or len(payload) != named * width * _SIZE[code] or len(links) % _LINK or frame_kind > 127:
                raise ValueError(f"wrong-shape: {len(payload)} bytes of payload from {len(source)} of sources")
            head = _BATCH.pack(_ARRAY | _BATCH_ITEMS, frame_kind, _U32, number, code, _U32, width, _BIN32, len(source))
            parts += head, source, _BYTES.pack(_BIN32, len(payload)), payload, _BYTES.pack(_BIN32, len(links)), links
    except (struct.error, KeyError, IndexError) as error:
        raise ValueError(f"wrong-shape: {error}") from None
    return b"".join(parts)


def _read_batch(raw: bytes, at: int, uavs: int) -> tuple[Batch, int]:
    try:
        array, kind, number_, number, code, width_, width, source_, size = _BATCH.unpack_from(raw, at)
    except struct.error:
        raise ValueError("malformed: cut off") from None
    if array != _ARRAY | _BATCH_ITEMS or number_ != _U32 or width_ != _U32 or source_ != _BIN32 or kind > 127:
        raise ValueError("malformed: not the head of a batch")
    if code >= len(DTYPES) or size % _NAME:
        raise ValueError(f"wrong-shape: dtype {code}, {size} bytes of sources")
    sources, source = size // _NAME, at + _BATCH.size
    payload, payload_size = _bytes_at(raw, source + size)
    if payload_size != sources * width * _SIZE[code]:
        raise ValueError(f"wrong-shape: {payload_size} bytes of payload from {sources} UAVs")
    if DTYPES[code] in _FLOATS:
        _check_finite(raw, DTYPES[code], payload, payload_size)
    links, links_size = _bytes_at(raw, payload + payload_size)
    if links_size % _LINK:
        raise ValueError(f"wrong-shape: {links_size} bytes of links")
    if uavs:
        named = np.frombuffer(raw, "<u4", sources, source)  # a negative number becomes very large
        link = np.frombuffer(raw, "<u4", links_size // _NAME, links)
        if (named >= uavs).any() or (link[::2] >= sources).any() or (link[1::2] >= uavs).any():
            raise ValueError("wrong-shape: UAVs or rows that are not there")
    return (kind, number, code, width, sources, source, payload, links_size // _LINK, links), links + links_size


def _bytes_at(raw: bytes, at: int) -> tuple[int, int]:
    """Offset and number of the bytes of the byte string that begins at an offset."""
    try:
        mark, size = _BYTES.unpack_from(raw, at)
    except struct.error:
        raise ValueError("malformed: cut off") from None
    if mark != _BIN32 or at + _BYTES.size + size > len(raw):
        raise ValueError("malformed: not a byte string of that length")
    return at + _BYTES.size, size


def _check_finite(raw: bytes, dtype: str, at: int, size: int) -> None:
    item = np.dtype(dtype).itemsize
    if size % item:
        raise ValueError(f"wrong-shape: {size} bytes of {dtype}")
    if size and not np.isfinite(np.frombuffer(raw, dtype, size // item, at)).all():
        raise ValueError("non-finite: a number is not finite")
