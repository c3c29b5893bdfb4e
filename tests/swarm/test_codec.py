"""Messages are read as they were written, by us and by other libraries; their bytes are those of docs/wire.md."""

import re
import struct
from pathlib import Path
from typing import Any, get_type_hints

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.kernels import wire
from meanflock.kernels.wire import ACT, SENSE
from meanflock.net import keys, tick
from meanflock.swarm import events
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Event, FrameKind, Frames, Join, Ready, Refusal, Sense, Stop, Welcome
from tests.swarm.conftest import Backend
from tests.swarm.examples import DTYPES, EXAMPLES, GOLDEN, TYPES, arrays_in, read, same, written
from tests.swarm.ticks import QUICK, acts, as_documented, batches, finite, senses

each_form = pytest.mark.usefixtures("backend")


shapes = hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)
arrays = st.sampled_from(DTYPES).flatmap(lambda name: finite(name, shapes))
st.register_type_strategy(np.ndarray, arrays)
st.register_type_strategy(int, st.integers(-(2**63), 2**64 - 1))
counts = st.integers(0, 2**63 - 1)
OF_EVENTS = {  # by the type of a field
    int: counts,
    float: st.floats(allow_nan=False),
    str: st.text(max_size=5),
    int | None: st.none() | counts,
    tuple[int, ...]: st.lists(counts, max_size=3).map(tuple),
    tuple[float, ...]: st.lists(st.floats(allow_nan=False), max_size=3).map(tuple),
    tuple[float | None, ...]: st.lists(st.none() | st.floats(allow_nan=False), max_size=3).map(tuple),
    dict[str, float]: st.dictionaries(st.text(max_size=5), st.floats(allow_nan=False), max_size=3),
}
for event in events.TYPES.values():
    hints = {name: hint for name, hint in get_type_hints(event).items() if name in event.__struct_fields__}
    made = {name: OF_EVENTS.get(hint, st.from_type(hint)) for name, hint in hints.items()}
    st.register_type_strategy(event, st.builds(event, **made))


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
def test_every_message_survives_the_wire_and_its_arrays_arrive_read_only(kind: type) -> None:
    @QUICK
    @given(st.builds(kind, **dict.fromkeys(kind.__struct_fields__, ...)))
    def check(message: Any) -> None:
        received = control.decode(control.encode(message))
        same(received, message)
        for array in arrays_in(received):
            assert not array.flags.writeable

    check()


@QUICK
@given(st.dictionaries(st.text(max_size=5), st.one_of(arrays, st.binary(max_size=9), st.integers(-9, 9), st.none())))
def test_a_record_is_read_as_it_was_written(record: dict[str, Any]) -> None:
    read = control.decode_record(control.encode_record(record))
    assert set(read) == set(record)
    for name, value in record.items():
        same(read[name], value)


@QUICK
@given(st.dictionaries(st.text(max_size=3), st.integers(-1, 9), max_size=20), st.lists(st.binary(max_size=300)))
def test_a_record_in_parts_is_read_as_one_whose_last_value_is_its_last_parts(record, last: list[bytes]) -> None:
    parts = control.parts_of_record(record, "the last", last)
    assert all(part is given_ for part, given_ in zip(parts[1:], last, strict=True))
    assert control.decode_record(b"".join(parts)) == record | {"the last": b"".join(last)}


@pytest.mark.parametrize("other", [[], {3: 4}])
def test_a_value_that_is_no_record_is_malformed(other: Any) -> None:
    with pytest.raises(MessageRejected, match=r"^malformed"):
        control.decode_record(msgpack.packb(other))


def test_there_is_an_example_of_every_message() -> None:
    assert {type(message) for message in EXAMPLES.values()} == {*TYPES, Sense, Act}
    assert {path.stem for path in GOLDEN.glob("*.bin")} == set(EXAMPLES)


@each_form
@pytest.mark.parametrize("name", EXAMPLES)
def test_the_golden_bytes_are_written_and_read(name: str) -> None:
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    assert written(EXAMPLES[name]) == golden
    same(read(golden), EXAMPLES[name])


@each_form
@QUICK
@given(st.one_of(senses, acts()))
def test_a_message_is_read_as_it_was_written_by_us_and_by_other_libraries(message: Sense | Act) -> None:
    raw = written(message)
    received = read(raw)
    same(received, message)
    for array in arrays_in(received):
        assert not array.flags.writeable
    for unpack in (msgpack.unpackb, msgspec.msgpack.decode):
        same(as_documented(unpack(raw)), message)


@each_form
@QUICK
@given(batches())
def test_the_size_of_a_batch_in_a_message_is_known_beforehand(batch: Frames) -> None:
    silent = Frames(batch.kind, batch.round, batch.source, batch.payload)
    without, with_it = (tick.write_sense(Sense(1, 2, np.zeros((1, 4)), inbox=inbox)) for inbox in ((), (silent,)))
    assert silent.wire_bytes == len(with_it) - len(without)


@each_form
def test_numbers_of_any_memory_order_travel_as_their_values() -> None:
    grid = np.arange(24.0).reshape(4, 6)
    for view in (grid[:, 1:5], grid.T, grid[::-2], grid.astype(np.float32)):
        raw = tick.write_sense(Sense(1, 2, view))
        np.testing.assert_array_equal(tick.read_sense(raw).states, view)
        assert raw[24 : 24 + 8 * view.size] == view.astype("<f8").tobytes()
    named = {"lost": np.array([4, 6]), "refused_states": np.array([1], np.int16), "waiting": np.array([6])}
    got = tick.read_act(tick.write_act(Act(1, 2, grid, **named)))
    assert [getattr(got, name).tolist() for name in named] == [[4, 6], [1], [6]]  # numbers of UAVs travel as 32 bits


@pytest.mark.parametrize(
    "given_",
    [
        (3, 1, 1, 0, 0, 0, b"", (b"",)),
        (SENSE, -1, 1, 0, 0, 0, b"", (b"",)),
        (SENSE, 1, 2**32, 0, 0, 0, b"", (b"",)),
        (SENSE, 1, 1, 0, 1, 4, bytes(31), (b"",)),
        (SENSE, 1, 1, 0, 1, 4, bytes(32), (b"", b"")),
        (SENSE, 1, 1, 128, 0, 0, b"", (b"",)),
        (SENSE, 1, 1, 0, 0, 128, b"", (b"",)),
        (ACT, 1, 1, 0, 0, 0, b"", (b"",)),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, 0, 2, bytes(4), bytes(3), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, 0, 2, bytes(4), bytes(4), bytes(7))]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, 0, 2, bytes(5), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(128, 0, 0, 2, bytes(4), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, len(wire.DTYPES), 2, bytes(4), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 2**32, 0, 2, bytes(4), bytes(4), b"")]),
    ],
)
def test_a_message_that_does_not_fit_the_layout_is_not_written(backend: Backend, given_: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=r"^wrong-shape"):
        backend.write(*given_)


PAGE = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")
RUN = keys.fingerprint("test")
STATE = np.array([[150.0, 100.0, -1.5, 0.25]])
RECEIVED = Frames(
    FrameKind.STATE, 0, np.array([0, 2], "<i4"), np.array([[151, 100, 0, 0], [150, 101, 0, 0]], "<f4"),
    np.array([[0, 1], [1, 1]], "<i4"),
)  # fmt: skip
DUMPS = {
    "sense": tick.write_sense(Sense(RUN, 41, STATE, True, False, (RECEIVED,))),
    "act": tick.write_act(
        Act(
            RUN,
            41,
            np.array([[-2.55, -2.075, 0.5]]),
            refused_states=np.array([2]),
            models=np.array([[1.0, -1.0]]),
            outbox=(Frames(FrameKind.STATE, 0, np.array([1], "<i4"), STATE.astype("<f4")),),
        )
    ),
}
DUMP_LINE = re.compile(r" *(\d+)  ((?:[0-9a-f]{2} ?)+?)(?:  .*)?")


@pytest.mark.parametrize("name", DUMPS)
def test_the_page_dumps_the_bytes_that_are_sent(name: str) -> None:
    lines = PAGE.partition(f"<!-- dump of {name} -->\n```text\n")[2].partition("\n```")[0].splitlines()
    raw = b""
    for line in lines:
        found = DUMP_LINE.fullmatch(line)
        assert found is not None, line
        assert int(found[1]) == len(raw)
        raw += bytes.fromhex(found[2])
    assert raw == DUMPS[name]


def test_the_page_names_every_type_of_number_kind_of_frame_and_reason_of_a_reader() -> None:
    rows = [f"| {code} | `{name}` |" for code, name in enumerate(wire.DTYPES)]
    rows += [f"| {kind.value} | {kind.name} |" for kind in FrameKind]
    rows += {f"`{reason}`" for reason in re.findall(r"`([a-z-]+)`", MessageRejected.__doc__ or "")} - {"`reason`"}
    rows.append(f'`zlib.crc32(b"test")` is `{RUN:#010x}`')  # a run's fingerprint, which its messages begin with
    assert [row for row in rows if row not in PAGE] == []
    assert struct.pack(">I", RUN) in DUMPS["sense"]


@pytest.mark.parametrize("kind", [Join, Welcome, Refusal, Ready, Stop, Event])
def test_the_page_has_the_fields_of_a_control_message_in_their_order(kind: type[msgspec.Struct]) -> None:
    (row,) = (line for line in PAGE.splitlines() if line.startswith(f"| {kind.__name__} |"))
    assert re.findall(r"`(\w+)`", row.split("|")[2]) == [kind.__struct_config__.tag, *kind.__struct_fields__]


def test_the_page_s_example_of_an_array_is_one() -> None:
    found = re.search(r"`((?:[0-9a-f]{2} ){9}[0-9a-f]{2})` and the numbers\s+`((?:[0-9a-f]{2} ?)+)`", PAGE)
    array = msgspec.msgpack.Ext(1, bytes.fromhex(found[1] + found[2]))
    welcome = control.decode(msgspec.msgpack.encode(["welcome", 1, "agent-0", [0], 0, b"{}", array]))
    np.testing.assert_array_equal(welcome.initial_states, np.array([[1.5, -2.0]], "<f4"))


def test_fields_with_a_default_may_be_left_out_from_the_end() -> None:
    join = control.decode(msgspec.msgpack.encode(["join", "agent", 1]))
    assert (join.role, join.rows, join.uav, join.token) == ("agent", 1, -1, 0)
    assert isinstance(control.decode(msgspec.msgpack.encode(["event", 3, "agent", "a word"])), Event)
