"""Bytes from nobody we know: each is a message or is rejected with a reason, never worse."""

import itertools
import struct

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Finished, Ready, Received, Welcome
from tests.swarm.damage import damaged
from tests.swarm.examples import DTYPES, EXAMPLES, OF_A_TICK, RAW, TYPES, arrays_in, carrying, same

CONTROL = sorted(set(EXAMPLES) - set(OF_A_TICK))
HONEST = list(RAW.values())
REASONS = {"malformed", "oversized", "wrong-shape", "non-finite"}
MANY = settings(max_examples=2000, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow])


def decode_or_reject(raw: bytes) -> None:
    """The one promise to everyone who sends us bytes."""
    try:
        message = control.decode(raw)
    except MessageRejected as rejected:
        if rejected.reason not in REASONS:
            raise
        return
    assert isinstance(message, TYPES)
    for array in arrays_in(message):
        assert np.isfinite(array).all()
        assert not array.flags.writeable
    same(control.decode(control.encode(message)), message)


@MANY
@given(damaged(HONEST))
def test_damaged_bytes_are_a_message_or_are_rejected(raw: bytes) -> None:
    decode_or_reject(raw)


@settings(MANY, max_examples=500)
@given(st.binary(max_size=64))
def test_any_bytes_are_a_message_or_are_rejected(raw: bytes) -> None:
    decode_or_reject(raw)


@pytest.mark.parametrize("name", CONTROL)
def test_a_message_cut_off_anywhere_or_followed_by_anything_is_malformed(name: str) -> None:
    raw = RAW[name]
    for end in itertools.chain(range(min(len(raw), 300)), range(max(0, len(raw) - 50), len(raw))):
        with pytest.raises(MessageRejected, match=r"^malformed|^wrong-shape"):
            control.decode(raw[:end])
    with pytest.raises(MessageRejected, match=r"^malformed"):
        control.decode(raw + b"\0")
    with pytest.raises(MessageRejected, match=r"^malformed"):
        control.decode(raw + raw)


def test_nesting_without_end_is_malformed() -> None:
    for opener in (b"\x91", b"\x81\xa1a"):
        with pytest.raises(MessageRejected, match=r"^malformed"):
            control.decode(opener * 100_000)


def test_a_field_too_many_or_of_another_type_is_malformed() -> None:
    for wrong in (
        ["ready", 1, 2],
        ["ready", "1"],
        ["ready", 1.5],
        ["ready", None],
        ["nobody", 1],
        ["welcome", 1, "agent-0", [0], 2, b"{}", [[0.0] * 4]],
        ["sense", 1],
        ["join", 7, "agent"],
        [],
        {},
        "ready",
    ):
        with pytest.raises(MessageRejected, match=r"^malformed"):
            control.decode(msgpack.packb(wrong))


def message_with(array: bytes, extension: int = 1) -> bytes:
    return msgspec.msgpack.encode(["welcome", 1, "agent-0", [0], 2, b"{}", msgspec.msgpack.Ext(extension, array)])


def header(kind: int, shape: tuple[int, ...], axes: int | None = None) -> bytes:
    return struct.pack(f"<BB{len(shape)}I", kind, len(shape) if axes is None else axes, *shape)


MAX = 2**32 - 1
F8 = 2
HOSTILE_ARRAYS = {
    "no header": b"",
    "half a header": b"\x02",
    "unknown dtype": header(len(DTYPES), (1,)) + bytes(8),
    "last dtype": header(255, (1,)) + bytes(8),
    "five axes": header(F8, (1, 1, 1, 1, 1)) + bytes(8),
    "255 axes": header(F8, (), axes=255),
    "axes cut off": header(F8, (1,), axes=3),
    "too little": header(F8, (1, 4)) + bytes(31),
    "too much": header(F8, (1, 4)) + bytes(33),
    "nothing of a scalar": header(F8, ()),
    "huge": header(F8, (MAX, MAX, MAX)),
    "product is 2⁶⁴": header(F8, (2**31, 2**31, 4)),
    "product is 2³²": header(4, (2**16, 2**16)),
    "−1 as a count": header(F8, (MAX,)) + bytes(8),
    "−1 of rows": header(F8, (MAX, 4)) + bytes(32),
    "items count, not bytes": header(F8, (8,)) + bytes(8),
}


@pytest.mark.parametrize("name", HOSTILE_ARRAYS)
def test_an_array_whose_header_lies_is_rejected(name: str) -> None:
    with pytest.raises(MessageRejected, match=r"^malformed|^wrong-shape"):
        control.decode(message_with(HOSTILE_ARRAYS[name]))


@pytest.mark.parametrize("shape", [(0, MAX), (0, MAX, MAX), (MAX, 0, MAX), (MAX, MAX, 0), (0, 2**31, 2**31)])
def test_an_empty_array_with_huge_other_axes_is_a_message_or_is_rejected(shape: tuple[int, ...]) -> None:
    for kind in range(len(DTYPES)):
        decode_or_reject(message_with(header(kind, shape)))


@settings(MANY, max_examples=500)
@given(
    st.integers(0, len(DTYPES) + 1),
    st.lists(st.one_of(st.integers(0, 3), st.sampled_from([2**16, 2**31, MAX])), max_size=4),
    st.binary(max_size=40),
)
def test_any_header_is_an_array_or_is_rejected(kind: int, shape: list[int], buffer: bytes) -> None:
    decode_or_reject(message_with(header(kind, tuple(shape)) + buffer))


def test_only_our_own_extension_is_read() -> None:
    honest = header(F8, (1, 4)) + bytes(32)
    assert isinstance(control.decode(message_with(honest)), Welcome)
    for extension in (0, 2, 127, -1, -128):
        with pytest.raises(MessageRejected, match=r"^malformed"):
            control.decode(message_with(honest, extension))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", ["<f2", "<f4", "<f8"])
def test_a_number_that_is_not_finite_is_named_so(dtype: str, bad: float) -> None:
    table = np.zeros((3, 4), dtype=dtype)
    table[2, 3] = bad
    with pytest.raises(MessageRejected) as caught:
        control.decode(control.encode(carrying(table)))
    assert caught.value.reason == "non-finite"


def test_bytes_beyond_the_limit_are_oversized_and_are_not_even_parsed() -> None:
    with pytest.raises(MessageRejected) as caught:
        control.decode(b"\xc1" * 101, limit=100)
    assert caught.value.reason == "oversized"
    with pytest.raises(MessageRejected) as caught:
        control.decode(bytes(control.MAX_BYTES + 1))
    assert caught.value.reason == "oversized"
    raw = RAW["ready"]
    assert isinstance(control.decode(raw, limit=len(raw)), Ready)


def test_another_kind_and_another_run_are_named_so() -> None:
    raw = control.encode(Received(7, 1))
    assert control.decode_as(Received, raw, 7).block == 1
    with pytest.raises(MessageRejected) as caught:
        control.decode_as(Finished, raw, 7)
    assert caught.value.reason == "wrong-kind"
    with pytest.raises(MessageRejected) as caught:
        control.decode_as(Received, raw, 8)
    assert caught.value.reason == "wrong-run"


def test_a_shape_or_dtype_that_was_not_expected_is_named_with_what_came() -> None:
    table = np.zeros((3, 4))
    assert control.expect("states", table, (3, 4), np.float64) is table
    assert control.expect("states", table, (None, 4), np.float64) is table
    for shape, dtype in (
        ((2, 4), np.float64),
        ((3,), np.float64),
        ((3, 4, 1), np.float64),
        ((3, 4), np.float32),
        ((), np.float64),
    ):
        with pytest.raises(MessageRejected, match=r"states: expected .*, got \(3, 4\) float64") as caught:
            control.expect("states", table, shape, dtype)
        assert caught.value.reason == "wrong-shape"
