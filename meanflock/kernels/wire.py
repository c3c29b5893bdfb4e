"""Reader and writer of tick messages, whose layout `docs/wire.md` describes.

A message is a MessagePack array of small integers, 32-bit integers and byte strings with 32-bit lengths. MessagePack
has shorter forms of these, which the layout does not use. So the reader lets msgspec decode a message, lays out what it
got, and refuses the message if the bytes differ.

This is the definition; the compiled form has the same signatures, results and reasons.
"""

import struct
from collections.abc import Sequence
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np

from meanflock.kernels.state import Floats

SENSE, ACT = 1, 2  # types of a message
TABLES = {SENSE: "db", ACT: "diiiidb"}  # types of the tables: b bytes, i int32, d float64

# Of a batch: kind, round, dtype code, numbers in a row of the payload, sources, payload, links.
Batch: TypeAlias = tuple[int, int, int, int, Any, Any, Any]
# Type, run, tick, flags, rows, columns, first table, other tables, batches: the arguments of `write`.
Message: TypeAlias = tuple[int, int, int, int, int, int, Any, tuple[Any, ...], Sequence[Batch]]

DTYPES = ("<f2", "<f4", "<f8", "<i4", "u1", "<i2", "i1")
_FLOATS = ("<f2", "<f4", "<f8")
_SIZE = tuple(np.dtype(name).itemsize for name in DTYPES)
_ITEM = {"b": 1, "i": 4, "d": 8}  # bytes of a number of a table
_NAME = 4  # bytes of a source, int32
_LINK = 8  # bytes: [row of payload, receiving UAV], int32
_MOST = 127  # of an integer that is written as one byte

_HEAD = struct.Struct(">BBBIBIBBIB")
_BATCH = struct.Struct(">BBBIBBI")
_COUNT = struct.Struct(">BH")
_BYTES = struct.Struct(">BI")
BATCH_BYTES = _BATCH.size + 3 * _BYTES.size  # of a batch around its sources, payload and links
_Batches = Annotated[list[tuple[int, int, int, int, bytes, bytes, bytes]], msgspec.Meta(max_length=2**16 - 1)]
_SENSE = msgspec.msgpack.Decoder(tuple[int, int, int, int, int, int, bytes, bytes, _Batches])
_ACT = msgspec.msgpack.Decoder(
    tuple[int, int, int, int, int, int, bytes, bytes, bytes, bytes, bytes, bytes, bytes, _Batches]
)


def read(raw: bytes, kind: int = 0, into: Floats | None = None, uavs: int = 0, /) -> Message:
    """Read the parts of a message; its tables and arrays are bytes.

    Args:
        kind: the required type; 0 for any. into: (rows, columns), float64, array to which the first table is written
            after all other checks; None: none. uavs: number of all UAVs, by which sources and links of frames are
            checked; 0: unchecked.

    Raises:
        ValueError: the text begins with a reason and a colon, the first that applies. `malformed`: another layout.
            `wrong-shape`: bytes that do not fit their numbers, or frames that name UAVs or rows of their payload that
            are not there. `non-finite`: a float that is not finite. `wrong-kind`: the other type. `wrong-shape`: a
            first table of another shape than `into` (any columns if there are no rows).
    """
    try:
        message = (_ACT if raw[1:2] == bytes([ACT]) else _SENSE).decode(raw)
        type_, run, tick, flags, rows, columns, *tables, batches = message
        if raw != _laid_out(type_, run, tick, flags, rows, columns, tables, batches):
            raise ValueError("malformed: other integers or lengths than those of a tick message")
        letters = TABLES[type_]
    except (msgspec.DecodeError, struct.error, KeyError) as error:
        raise ValueError(f"malformed: {error}") from None
    _check_sizes(letters, rows, columns, tables, batches)
    for batch in batches if uavs else ():
        _check_names(batch, uavs)
    floats = [(part, "<f8") for part, letter in zip(tables, letters, strict=True) if letter == "d"]
    floats += [(batch[5], DTYPES[batch[2]]) for batch in batches if DTYPES[batch[2]] in _FLOATS]
    if not all(np.isfinite(np.frombuffer(part, dtype)).all() for part, dtype in floats):
        raise ValueError("non-finite: a number is not finite")
    if kind and kind != type_:
        raise ValueError("wrong-kind: a message of the other type")
    table, *others = tables
    if into is not None:
        if len(into) != rows or (rows and into.shape[1] != columns):
            raise ValueError("wrong-shape: a first table of other rows or columns than expected")
        into[:] = np.frombuffer(table, "<f8").reshape(into.shape)
    return type_, run, tick, flags, rows, columns, table, tuple(others), tuple(batches)


def write(
    kind: int,
    run: int,
    tick: int,
    flags: int,
    rows: int,
    columns: int,
    table: Any,
    tables: tuple[Any, ...],
    frames: Sequence[Batch] = (),
    /,
) -> bytes:
    """Write a message of these parts; tables and arrays are contiguous little-endian buffers.

    Args:
        table: rows × columns float64. tables: the others of the type. frames: [kind, round, dtype code, numbers in a
            row of the payload, source, payload, links] of each batch.

    Raises:
        ValueError: a number or a buffer does not fit the layout.
    """
    parts = [*map(bytes, (table, *tables))]
    batches: list[Batch] = [(*frame[:4], bytes(frame[4]), bytes(frame[5]), bytes(frame[6])) for frame in frames]
    if kind not in TABLES or len(parts) != len(TABLES[kind]):
        raise ValueError("wrong-shape: no such type, or other tables")
    if max(flags, columns, *(batch[0] for batch in batches)) > _MOST:
        raise ValueError(f"wrong-shape: flags, columns and kinds are numbers up to {_MOST}")
    _check_sizes(TABLES[kind], rows, columns, parts, batches)
    try:
        return _laid_out(kind, run, tick, flags, rows, columns, parts, batches)
    except struct.error as error:
        raise ValueError(f"wrong-shape: {error}") from None


def _laid_out(
    kind: int,
    run: int,
    tick: int,
    flags: int,
    rows: int,
    columns: int,
    tables: Sequence[bytes],
    batches: Sequence[Batch],
) -> bytes:
    mark = 0x90 | (7 + len(tables))  # an array of so many items
    parts = [_HEAD.pack(mark, kind, 0xCE, run, 0xCE, tick, flags, 0xCE, rows, columns)]
    parts += map(_counted, tables)
    parts.append(_COUNT.pack(0xDC, len(batches)))
    for label, number, code, width, *arrays in batches:
        parts.append(_BATCH.pack(0x97, label, 0xCE, number, code, 0xCE, width))
        parts += map(_counted, arrays)
    return b"".join(parts)


def _counted(value: bytes) -> bytes:
    return _BYTES.pack(0xC6, len(value)) + value


def _check_sizes(letters: str, rows: int, columns: int, tables: Sequence[bytes], batches: Sequence[Batch]) -> None:
    if len(tables[0]) != 8 * rows * columns:
        raise ValueError(f"wrong-shape: {rows} × {columns} numbers in {len(tables[0])} bytes")
    if any(len(part) % _ITEM[letter] for part, letter in zip(tables, letters, strict=True)):
        raise ValueError("wrong-shape: a table that ends within a number")
    for _, _, code, width, source, payload, links in batches:
        if code >= len(DTYPES) or len(source) % _NAME or len(links) % _LINK:
            raise ValueError(f"wrong-shape: dtype {code}, {len(source)} bytes of sources, {len(links)} of links")
        if len(payload) != len(source) // _NAME * width * _SIZE[code]:
            raise ValueError(f"wrong-shape: {len(payload)} bytes of payload from {len(source)} of sources")


def _check_names(batch: Batch, uavs: int) -> None:
    # As unsigned numbers, negative ones are very large.
    source, links = (np.frombuffer(part, "<u4") for part in (batch[4], batch[6]))
    if (source >= uavs).any() or (links[::2] >= len(source)).any() or (links[1::2] >= uavs).any():
        raise ValueError("wrong-shape: UAVs or rows that are not there")
