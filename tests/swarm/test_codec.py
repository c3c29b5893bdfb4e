"""Control messages: what goes in comes out, and old bytes stay readable."""

import struct
import types
import typing
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import (
    Act,
    Event,
    Refusal,
    Sense,
    Stop,
)
from tests.swarm.examples import (
    DTYPES,
    EXAMPLES,
    GOLDEN,
    OF_A_TICK,
    RAW,
    TYPES,
    arrays_in,
    carrying,
    read,
    same,
)

LETTERS = "efdiBhbq?"  # of `struct`
QUICK = settings(max_examples=60, deadline=None, database=None)


def arrays() -> st.SearchStrategy[np.ndarray]:
    """Finite arrays of every dtype that travels, up to three axes, empty ones too."""
    shapes = hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)

    def of(name: str) -> st.SearchStrategy[np.ndarray]:
        dtype = np.dtype(name)
        if dtype.kind != "f":
            return hnp.arrays(dtype, shapes)
        numbers = st.floats(width=8 * dtype.itemsize, allow_nan=False, allow_infinity=False)  # type: ignore[arg-type]
        return hnp.arrays(dtype, shapes, elements=numbers)

    return st.sampled_from(DTYPES).flatmap(of)


def of_type(annotation: Any) -> st.SearchStrategy[Any]:
    """Values of a field's type."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (types.UnionType, typing.Union):
        return st.one_of(*map(of_type, arguments))
    if origin is typing.Literal:
        return st.sampled_from(arguments)
    if origin is tuple and arguments[-1] is not Ellipsis:
        return st.tuples(*map(of_type, arguments))
    if origin is tuple:
        return st.lists(of_type(arguments[0]), max_size=3).map(tuple)
    if annotation is np.ndarray:
        return arrays()
    if annotation is int:
        return st.integers(-(2**63), 2**64 - 1)
    if annotation is Event:
        return of_message(annotation)
    simple: dict[Any, st.SearchStrategy[Any]] = {
        str: st.text(max_size=8),
        bytes: st.binary(max_size=16),
        bool: st.booleans(),
        type(None): st.none(),
    }
    return simple[annotation]


def of_message(kind: type) -> st.SearchStrategy[Any]:
    """Messages of one kind."""
    return st.builds(kind, **{name: of_type(t) for name, t in typing.get_type_hints(kind).items()})


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
def test_every_message_survives_the_wire_and_its_arrays_arrive_read_only(kind: type) -> None:
    @QUICK
    @given(of_message(kind))
    def check(message: Any) -> None:
        received = control.decode(control.encode(message))
        same(received, message)
        for array in arrays_in(received):
            assert not array.flags.writeable

    check()


def test_an_array_that_is_no_contiguous_block_travels_as_its_values() -> None:
    table = np.arange(24.0).reshape(4, 6)
    for view in (table[:, 1:3], table.T, table[::-2]):
        np.testing.assert_array_equal(control.decode(control.encode(carrying(view))).initial_states, view)  # type: ignore[union-attr]


@QUICK
@given(st.dictionaries(st.text(max_size=5), st.one_of(arrays(), st.binary(max_size=9), st.integers(-9, 9), st.none())))
def test_a_record_is_read_as_it_was_written(record: dict[str, Any]) -> None:
    read = control.decode_record(control.encode_record(record))
    assert set(read) == set(record)
    for name, value in record.items():
        same(read[name], value)


@pytest.mark.parametrize("other", [[], "record", 3, {3: 4}, None])
def test_what_is_no_record_is_rejected(other: Any) -> None:
    with pytest.raises(MessageRejected, match=r"^malformed"):
        control.decode_record(msgpack.packb(other))


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
def test_the_largest_number_is_finite_and_what_is_beyond_it_is_not(dtype: str) -> None:
    array = np.full((2, 3), np.finfo(dtype).max, dtype=dtype)
    assert control.finite(array)
    assert control.finite(array[:0])
    for bad in (np.nan, np.inf, -np.inf):
        array[1, 1] = bad
        assert not control.finite(array)
        array[0, 0] = -np.inf
        assert not control.finite(array)


@pytest.mark.parametrize("dtype", [">f8", "<u8", "c16", "O", "S3"])
def test_an_array_of_a_dtype_that_does_not_travel_cannot_be_sent(dtype: str) -> None:
    with pytest.raises(KeyError):
        control.encode(carrying(np.zeros((1, 4)).astype(dtype)))


def plain(value: Any) -> Any:
    """What a reader that knows nothing of us should find."""
    if isinstance(value, msgspec.Struct):
        tag = value.__struct_config__.tag
        fields = [plain(getattr(value, name)) for name in value.__struct_fields__]
        return fields if tag is None else [tag, *fields]
    if isinstance(value, tuple):
        return [plain(part) for part in value]
    if isinstance(value, np.ndarray):
        return {"dtype": value.dtype.str, "shape": list(value.shape), "values": value.ravel().tolist()}
    return value


def read_array(code: int, data: bytes) -> Any:
    """The extension as the codec's docstring describes it, read with `struct` alone."""
    assert code == 1
    kind, axes = data[0], data[1]
    shape = struct.unpack_from(f"<{axes}I", data, 2)
    name, letter = np.dtype(DTYPES[kind]).str, LETTERS[kind]
    count = int(np.prod(shape, dtype=int))
    values = struct.unpack_from(f"<{count}{letter}", data, 2 + 4 * axes)
    return {"dtype": name, "shape": list(shape), "values": list(values)}


def test_there_is_an_example_of_every_message() -> None:
    assert {type(message) for message in EXAMPLES.values()} == {*TYPES, Sense, Act}
    assert {path.stem for path in GOLDEN.glob("*.bin")} == set(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_todays_encoder_writes_the_golden_bytes_and_reads_them(name: str) -> None:
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    assert RAW[name] == golden
    same(read(golden), EXAMPLES[name])


@pytest.mark.parametrize("name", sorted(set(EXAMPLES) - set(OF_A_TICK)))
def test_an_independent_reader_understands_the_golden_bytes(name: str) -> None:
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    read_by_hand, expected = msgpack.unpackb(golden, ext_hook=read_array), plain(EXAMPLES[name])
    there = len(read_by_hand)
    assert read_by_hand == expected[:there]
    assert not any(expected[there:])  # what is left out says nothing


def test_what_came_later_is_left_out_where_it_says_nothing() -> None:
    """An older reader finds the fields that it knows, in all but the messages that are of the new kind."""
    assert msgpack.unpackb(control.encode(Stop(1, "finished"))) == ["stop", 1, "finished"]
    assert msgpack.unpackb(control.encode(Stop(1, "gone", lost=True))) == ["stop", 1, "gone", True]
    assert msgpack.unpackb(control.encode(Refusal("taken"))) == ["refusal", "taken", False]
    assert msgpack.unpackb(control.encode(Refusal("late", over=True))) == ["refusal", "late", False, True]
    for message in (Stop(1, "x"), Stop(1, "x", True), Refusal("x"), Refusal("x", True), Refusal("x", False, True)):
        back = control.decode(control.encode(message))
        assert msgspec.structs.astuple(back) == msgspec.structs.astuple(message)
