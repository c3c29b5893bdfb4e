"""The wire: what goes in comes out, and old bytes stay readable.

`python -m tests.swarm.test_codec` writes the golden files anew; do that only when a message changes on purpose.
"""

import struct
import types
import typing
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.kernels.wire import SENSE
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control, tick
from meanflock.swarm.wire.messages import (
    Act,
    Event,
    Finished,
    FrameKind,
    Frames,
    Join,
    Message,
    Ready,
    Received,
    Refusal,
    Sense,
    Stop,
    Telemetry,
    Welcome,
)

GOLDEN = Path(__file__).parents[1] / "golden"
TYPES: tuple[type, ...] = typing.get_args(Message)  # of control messages; those of a tick are in test_tick.py
DTYPES = ("<f2", "<f4", "<f8", "<i4", "u1", "<i2", "i1", "<i8", "?")
LETTERS = "efdiBhbq?"  # of `struct`
QUICK = settings(max_examples=60, deadline=None, database=None)

# -- every message there is, made from the types of its fields ----------------------------------------------------


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


def same(one: Any, other: Any) -> None:
    """Equal to the last bit: types, dtypes, shapes, values."""
    assert type(one) is type(other)
    if isinstance(one, msgspec.Struct):
        for name in one.__struct_fields__:
            same(getattr(one, name), getattr(other, name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            same(a, b)
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    else:
        assert one == other


def arrays_in(value: Any) -> list[np.ndarray]:
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, msgspec.Struct):
        value = tuple(getattr(value, name) for name in value.__struct_fields__)
    return [array for part in value for array in arrays_in(part)] if isinstance(value, tuple) else []


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


def carrying(array: np.ndarray) -> Welcome:
    """A message with one array."""
    return Welcome(1, "agent-0", (0,), 2, b"{}", array)


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


# -- golden bytes -------------------------------------------------------------------------------------------------


def numbers(dtype: str, *shape: int) -> np.ndarray:
    """A table that is easy to recognise in a hex dump."""
    count = int(np.prod(shape))
    return (np.arange(count) - count // 2).reshape(shape).astype(dtype)


FRAMES = Frames(FrameKind.UPLOAD, 3, numbers("<i4", 2) + 4, numbers("<f4", 2, 5) / 2)
DELIVERED = Frames(FrameKind.STATE, 0, numbers("<i4", 1), numbers("<f2", 1, 4), np.array([[0, 1], [0, 2]], dtype="<i4"))
EXAMPLES: dict[str, Any] = {
    "join": Join("agent", 5, 20),
    "welcome": Welcome(
        run=0xDEADBEEF,
        node="agent-5",
        uavs=(5, 6, 300),
        tick=70000,
        scenario=b'{"uavs":301}',
        initial_states=numbers("<f4", 3, 4) + 0.25,
        memory=control.encode_record({"weights": numbers("<f8", 3, 2) / 9, "uav": numbers("<i8", 3)}),
        plugins=(("controller", "spring", "sha256 0123"), ("aggregator", "fedavg", "meanflock 1.0")),
    ),
    "refusal": Refusal("every UAV of this run has its agent already – größer"),
    "ready": Ready(0xDEADBEEF),
    "sense": Sense(0xDEADBEEF, 99, numbers("<f8", 2, 4) / 3, True, False, (FRAMES, DELIVERED), b"\x80"),
    "act": Act(
        run=0xDEADBEEF,
        tick=99,
        commands=numbers("<f8", 2, 5) / 7,
        lost=np.array([6], dtype="<i4"),
        refused=np.array([1, 300], dtype="<i4"),
        models=numbers("<f8", 2, 246) / 9,
        memory=control.encode_record({"weights": numbers("<f8", 2, 3)}),
        outbox=(FRAMES,),
    ),
    "stop": Stop(0xDEADBEEF, "finished"),
    "event": Event(12, "collision", "UAV 1 and UAV 2 collided", (1, 2)),
    "telemetry": Telemetry(
        run=0xDEADBEEF,
        block=7,
        first_tick=140,
        states=numbers("<f8", 2, 3, 4) / 3,
        accelerations=numbers("<f4", 2, 3, 2) / 7,
        diagnostics=numbers("<f4", 2, 3, 3) / 7,
        status=numbers("u1", 2, 3) % 3,
        energy=numbers("<f4", 2, 3),
        swarm=numbers("<f8", 2, 12),
        links=numbers("<i4", 2, 5),
        report_ticks=numbers("<i4", 1),
        reports=numbers("<f4", 1, 246),
        spread=numbers("<f8", 1) + 0.5,
        events=(Event(141, "round", "round 1 averaged and broadcast"),),
        checkpoint=b"\x93\x01\x02\x03",
        diagnostic_names=("hjb_residual", "fpk_residual", "phi_G"),
    ),
    "received": Received(0xDEADBEEF, 7),
    "finished": Finished(0xDEADBEEF, 88, b'{"schema":1}'),
}
OF_A_TICK = ("sense", "act")


def written(message: Any) -> bytes:
    """The bytes of any message."""
    if isinstance(message, Sense):
        return tick.write_sense(message)
    return tick.write_act(message) if isinstance(message, Act) else control.encode(message)


def read(raw: bytes) -> Any:
    """Any message."""
    if raw[1:2] not in tick.TYPES:
        return control.decode(raw)
    return tick.read_sense(raw) if raw[1] == SENSE else tick.read_act(raw)


RAW = {name: written(message) for name, message in EXAMPLES.items()}


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


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    for title, raw_bytes in RAW.items():
        (GOLDEN / f"{title}.bin").write_bytes(raw_bytes)
