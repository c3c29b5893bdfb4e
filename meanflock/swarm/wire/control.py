"""Control messages and records ⇄ MessagePack. Bytes from the network are not trusted: `decode` and `expect` check them.
The messages of a tick have a layout of their own, see `net/tick.py`.

An array travels as a msgpack extension: dtype code, number of axes, axes as 32-bit counts, then its little-endian
buffer. Nothing is ever unpickled; a decoded array is a read-only view of the received bytes.
"""

import math
import struct
from collections.abc import Sequence
from typing import Any, TypeVar

import msgpack
import msgspec
import numpy as np

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire.messages import Message

MAX_BYTES = 512 * 2**20  # of any message; the world has a lower limit for each node, by the scenario

_ARRAY = 1  # the extension code
_BYTES = struct.Struct(">BI")  # of bytes in MessagePack: `_BIN_32` and their number
_BIN_32 = 0xC6
_DTYPES = tuple(np.dtype(name) for name in ("<f2", "<f4", "<f8", "<i4", "u1", "<i2", "i1", "<i8", "?"))
_CODE = {dtype: code for code, dtype in enumerate(_DTYPES)}
MAX_AXES = 5
TRAVELS = frozenset(_DTYPES)  # dtypes an array can have

FLOAT_OF_BITS = {16: _DTYPES[0], 32: _DTYPES[1], 64: _DTYPES[2]}  # Radio.bits_per_float → dtype

M = TypeVar("M")


def _unpack(code: int, data: memoryview) -> np.ndarray:
    if code != _ARRAY or len(data) < 2:
        raise MessageRejected("malformed", f"extension {code} of {len(data)} bytes")
    kind, axes = data[0], data[1]
    start = 2 + 4 * axes
    if kind >= len(_DTYPES) or axes > MAX_AXES or len(data) < start:
        raise MessageRejected("malformed", f"array header ({kind}, {axes})")
    dtype, shape = _DTYPES[kind], struct.unpack_from(f"<{axes}I", data, 2)
    if len(data) - start != math.prod(shape) * dtype.itemsize:
        raise MessageRejected("wrong-shape", f"array {shape} {dtype} in {len(data) - start} bytes")
    try:
        array: np.ndarray = np.ndarray(shape, dtype, data, start)
    except ValueError as error:  # an empty array with an axis that NumPy cannot address
        raise MessageRejected("wrong-shape", f"array {shape} {dtype}: {error}") from error
    if dtype.kind == "f" and not finite(array):
        raise MessageRejected("non-finite", f"array {shape} {dtype}")
    return array


def _plain(value: Any) -> Any:
    """Encode values that msgpack does not know: arrays, and messages in messages."""
    if isinstance(value, np.ndarray):
        head = struct.pack(f"<BB{value.ndim}I", _CODE[value.dtype], value.ndim, *value.shape)
        return msgpack.ExtType(_ARRAY, head + value.tobytes())
    if isinstance(value, msgspec.Struct):
        return [value.__struct_config__.tag, *msgspec.structs.astuple(value)]
    raise TypeError(f"a message cannot carry {type(value).__name__}")


def _unpacked(raw: bytes) -> Any:
    """Unpack MessagePack, with limits: no part may claim to be longer than all of `raw`.

    Raises:
        MessageRejected: `malformed`, `wrong-shape` or `non-finite`.
    """
    most = len(raw)
    try:
        return msgpack.unpackb(
            raw,
            ext_hook=_unpack,
            strict_map_key=True,
            max_str_len=most,
            max_bin_len=most,
            max_ext_len=most,
            max_array_len=most,
            max_map_len=most,
        )
    except (ValueError, RecursionError, OverflowError) as error:  # the errors of msgpack are ValueErrors
        raise MessageRejected("malformed", str(error) or type(error).__name__) from error


def encode(message: Message) -> bytes:
    """The bytes of a control message.

    Raises:
        KeyError: an array of another dtype than those of `TRAVELS`.
    """
    return bytes(msgpack.packb(message, default=_plain))


def decode(raw: bytes, limit: int = MAX_BYTES) -> Message:
    """The control message in `raw`, its arrays consistent with their headers and finite.

    Raises:
        MessageRejected: `oversized`, `malformed`, `wrong-shape` or `non-finite`.
    """
    if len(raw) > limit:
        raise MessageRejected("oversized", f"{len(raw)} bytes, at most {limit} expected")
    try:
        return msgspec.convert(_unpacked(raw), Message)
    except (msgspec.ValidationError, RecursionError) as error:
        raise MessageRejected("malformed", str(error)) from error


def encode_record(record: dict[str, Any]) -> bytes:
    """Encode plain values and arrays under names, for checkpoints and files."""
    return bytes(msgpack.packb(record, default=_plain))


def parts_of_record(record: dict[str, Any], name: str, last: Sequence[bytes]) -> list[bytes]:
    """Encode a record whose last value, `name`, is long: the bytes of `last`, joined. They are not copied: what comes
    before them is the first part of the result, and they are the others."""
    packer = msgpack.Packer(default=_plain)
    items = (packer.pack(one) for item in record.items() for one in item)
    head = [
        packer.pack_map_header(len(record) + 1),
        *items,
        packer.pack(name),
        _BYTES.pack(_BIN_32, sum(map(len, last))),
    ]
    return [b"".join(head), *last]


def decode_record(raw: bytes) -> dict[str, Any]:
    """Decode bytes of `encode_record`; its arrays are consistent with their headers and finite.

    Raises:
        MessageRejected: like `decode`.
    """
    record = _unpacked(raw)
    if not isinstance(record, dict) or not all(isinstance(name, str) for name in record):
        raise MessageRejected("malformed", f"{type(record).__name__}, expected values under names")
    return record


def decode_as(kind: type[M], raw: bytes, run: int, limit: int = MAX_BYTES) -> M:
    """Like `decode`, for a message that must be of one kind and of this run.

    Raises:
        MessageRejected: also `wrong-kind` and `wrong-run`.
    """
    message = decode(raw, limit)
    if not isinstance(message, kind):
        raise MessageRejected("wrong-kind", f"{type(message).__name__}, expected {kind.__name__}")
    got = getattr(message, "run", None)
    if got != run:
        raise MessageRejected("wrong-run", f"run {got}, this is {run}")
    return message


def finite(array: np.ndarray) -> bool:
    """Returns whether all numbers of an array are finite."""
    return bool(np.isfinite(array).all())


def expect(name: str, array: np.ndarray, shape: tuple[int | None, ...], dtype: Any) -> np.ndarray:
    """Check dtype and shape (None: any length) of an array, and return it.

    Raises:
        MessageRejected: `wrong-shape`; the message names the array, what was expected and what came.
    """
    fits = array.dtype == dtype and array.ndim == len(shape)
    if not fits or any(want is not None and want != got for want, got in zip(shape, array.shape, strict=True)):
        wanted = f"{tuple('any' if n is None else n for n in shape)} {np.dtype(dtype)}"
        raise MessageRejected("wrong-shape", f"{name}: expected {wanted}, got {array.shape} {array.dtype}")
    return array
