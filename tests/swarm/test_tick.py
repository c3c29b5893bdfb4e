"""The messages of a tick: what goes in comes out, every library reads it, and what is damaged is rejected."""

import struct
from collections.abc import Callable
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock import kernels
from meanflock.kernels.wire import ACT, DTYPES, FIRST, SENSE
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import load
from meanflock.swarm.wire import payload, tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense
from tests.swarm.backends import BACKENDS, REFERENCE, Backend, outcome
from tests.swarm.test_codec import EXAMPLES, GOLDEN, OF_A_TICK, RAW, arrays_in, same

QUICK = settings(
    max_examples=100, deadline=None, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
MANY = settings(QUICK, max_examples=2000)
REASONS = {"malformed", "wrong-shape", "non-finite", "wrong-kind"}
U32 = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True, params=BACKENDS)
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """All of this holds for every form of the reader and the writer."""
    chosen = BACKENDS[request.param]
    monkeypatch.setattr(kernels, "read", chosen.read)
    monkeypatch.setattr(kernels, "write", chosen.write)
    return chosen


# -- messages of all shapes ---------------------------------------------------------------------------------------


def table(dtype: str, rows: st.SearchStrategy[int], columns: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray]:
    """Finite numbers in two axes."""
    kind = np.dtype(dtype)
    numbers = None
    if kind.kind == "f":
        numbers = st.floats(width=8 * kind.itemsize, allow_nan=False, allow_infinity=False)  # type: ignore[call-overload]
    return hnp.arrays(kind, st.tuples(rows, columns), elements=numbers)


def uavs(size: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.dtype("<i4"), size)


@st.composite
def batches(draw: st.DrawFn) -> Frames:
    """Frames of any kind, number, dtype and width; of no UAV, and of no width, too."""
    sources = draw(st.integers(0, 5))
    said = draw(table(draw(st.sampled_from(DTYPES)), st.just(sources), st.integers(0, 9)))
    links = draw(st.none() | hnp.arrays(np.dtype("<i4"), st.tuples(st.integers(1, 6), st.just(2))))
    return Frames(draw(st.sampled_from(FrameKind)), draw(U32), draw(uavs(st.just(sources))), said, links)


few = st.lists(batches(), max_size=4).map(tuple)
senses = st.builds(
    Sense,
    run=U32,
    tick=U32,
    states=table("<f8", st.integers(0, 4), st.integers(0, 5)),
    report=st.booleans(),
    checkpoint=st.booleans(),
    inbox=few,
    memory=st.binary(max_size=40),
)


@st.composite
def acts(draw: st.DrawFn) -> Act:
    rows = draw(st.integers(0, 4))
    models = table("<f8", st.just(rows), st.integers(1, 7)) if rows else st.none()
    return Act(
        run=draw(U32),
        tick=draw(U32),
        commands=draw(table("<f8", st.just(rows), st.integers(0, 9))),
        lost=draw(uavs(st.integers(0, 4))),
        refused=draw(uavs(st.integers(0, 4))),
        models=draw(st.none() | models),
        memory=draw(st.binary(max_size=40)),
        outbox=draw(few),
    )


def written(message: Sense | Act) -> bytes:
    return tick.write_sense(message) if isinstance(message, Sense) else tick.write_act(message)


def read(raw: bytes) -> Sense | Act:
    """Whichever it says it is, as both receivers would take it."""
    return tick.read_act(raw) if raw[1:2] == bytes([ACT]) else tick.read_sense(raw)


# -- round trips and other readers --------------------------------------------------------------------------------


@QUICK
@given(st.one_of(senses, acts()))
def test_a_message_is_read_as_it_was_written_and_its_arrays_cannot_be_written_to(message: Sense | Act) -> None:
    received = read(written(message))
    same(received, message)
    for array in arrays_in(received):
        assert not array.flags.writeable


def numbers_of(dtype: str, raw: bytes) -> list[Any]:
    """Numbers of a dtype, without NumPy."""
    letter, size = {"<f2": "e", "<f4": "f", "<f8": "d", "<i4": "i", "u1": "B", "<i2": "h", "i1": "b"}[dtype], 0
    size = struct.calcsize(f"<{letter}")
    assert len(raw) % size == 0
    return list(struct.unpack(f"<{len(raw) // size}{letter}", raw))


def as_documented(tree: list[Any]) -> dict[str, Any]:
    """The fields of a message that some library unpacked, as docs/wire.md describes them; not read by ours."""
    kind, run, number, flags, rows, columns, first, *rest = tree
    fields: dict[str, Any] = {"run": run, "tick": number, "table": (rows, columns, numbers_of("<f8", first))}
    if kind == SENSE:
        memory, frames = rest
        fields |= {"report": bool(flags & 1), "checkpoint": bool(flags & 2), "memory": memory}
    else:
        lost, refused, models, memory, frames = rest
        assert flags == 0
        fields |= {"lost": numbers_of("<i4", lost), "refused": numbers_of("<i4", refused), "memory": memory}
        fields["models"] = numbers_of("<f8", models)
    fields["frames"] = []
    for of, round_, code, width, source, said, links in frames:
        pairs = numbers_of("<i4", links)
        batch = [of, round_, DTYPES[code], width, numbers_of("<i4", source), numbers_of(DTYPES[code], said)]
        fields["frames"].append([*batch, list(zip(pairs[::2], pairs[1::2], strict=True))])
    return fields


def as_meant(message: Sense | Act) -> dict[str, Any]:
    """The same of a message as it is in memory."""
    first = message.states if isinstance(message, Sense) else message.commands
    fields: dict[str, Any] = {
        "run": message.run,
        "tick": message.tick,
        "table": (*first.shape, first.ravel().tolist()),
        "memory": message.memory,
        "frames": [],
    }
    if isinstance(message, Sense):
        fields |= {"report": message.report, "checkpoint": message.checkpoint}
    else:
        fields |= {"lost": message.lost.tolist(), "refused": message.refused.tolist()}
        fields["models"] = [] if message.models is None else message.models.ravel().tolist()
    for batch in message.inbox if isinstance(message, Sense) else message.outbox:
        dtype = next(name for name in DTYPES if np.dtype(name) == batch.payload.dtype)
        links = [] if batch.links is None else [tuple(pair) for pair in batch.links.tolist()]
        head = [int(batch.kind), batch.round, dtype, batch.payload.shape[1], batch.source.tolist()]
        fields["frames"].append([*head, batch.payload.ravel().tolist(), links])
    return fields


@pytest.mark.parametrize("unpack", [msgpack.unpackb, msgspec.msgpack.decode], ids=["msgpack", "msgspec"])
def test_other_libraries_read_every_field(unpack: Callable[[bytes], Any]) -> None:
    @QUICK
    @given(st.one_of(senses, acts()))
    def check(message: Sense | Act) -> None:
        assert as_documented(unpack(written(message))) == as_meant(message)

    check()


@pytest.mark.parametrize("name", OF_A_TICK)
def test_the_golden_bytes_are_written_and_read_by_us_and_by_others(name: str) -> None:
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    message = EXAMPLES[name]
    assert written(message) == golden == RAW[name]
    same(read(golden), message)
    for unpack in (msgpack.unpackb, msgspec.msgpack.decode):
        assert as_documented(unpack(golden)) == as_meant(message)


def test_the_first_numbers_are_aligned_and_numbers_of_any_memory_order_travel_as_their_values() -> None:
    grid = np.arange(24.0).reshape(4, 6)
    for view in (grid[:, 1:5], grid.T, grid[::-2], grid.astype(np.float32)):
        raw = tick.write_sense(Sense(1, 2, view))
        np.testing.assert_array_equal(tick.read_sense(raw).states, view)
        assert raw[FIRST : FIRST + 8 * view.size] == view.astype("<f8").tobytes()
    assert FIRST % 8 == 0


def test_numbers_of_uavs_travel_as_32_bits_whatever_they_were() -> None:
    act = Act(1, 2, np.zeros((3, 2)), lost=np.array([4, 6]), refused=np.array([1], np.int16))
    got = tick.read_act(tick.write_act(act))
    assert (got.lost.tolist(), got.refused.tolist()) == ([4, 6], [1])


@pytest.mark.parametrize("field", ["run", "tick"])
@pytest.mark.parametrize("number", [-1, 2**32])
def test_a_number_that_does_not_fit_cannot_be_written(field: str, number: int) -> None:
    with pytest.raises(ValueError, match="wrong-shape"):
        tick.write_sense(Sense(**{"run": 1, "tick": 2, "states": np.zeros((1, 4)), field: number}))


@pytest.mark.parametrize(
    "given_",
    [
        (3, 1, 1, 0, 0, 0, b"", (b"",)),
        (SENSE, 1, 1, 0, 1, 4, bytes(31), (b"",)),
        (SENSE, 1, 1, 0, 1, 4, bytes(32), (b"", b"")),
        (SENSE, 1, 1, 128, 0, 0, b"", (b"",)),
        (SENSE, 1, 1, 0, 0, 128, b"", (b"",)),
        (ACT, 1, 1, 0, 0, 0, b"", (b"",)),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, 0, 2, bytes(4), bytes(3), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, 0, 2, bytes(4), bytes(4), bytes(7))]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(128, 0, 0, 2, bytes(4), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, len(DTYPES), 2, bytes(4), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 2**32, 0, 2, bytes(4), bytes(4), b"")]),
    ],
)
def test_what_does_not_fit_the_layout_is_not_written(backend: Backend, given_: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=r"^wrong-shape"):
        backend.write(*given_)


def test_what_a_batch_takes_in_a_message_is_known_beforehand() -> None:
    @QUICK
    @given(batches())
    def check(batch: Frames) -> None:
        silent = Frames(batch.kind, batch.round, batch.source, batch.payload)
        without = len(tick.write_sense(Sense(1, 2, np.zeros((1, 4)))))
        with_it = len(tick.write_sense(Sense(1, 2, np.zeros((1, 4)), inbox=(silent,))))
        assert tick.bytes_of_batch(silent) == with_it - without

    check()


@pytest.mark.parametrize("method", ["mfgfl-h", "mfgfl-f", "mfgfl-hf"])
def test_an_upload_takes_at_most_a_tenth_more_than_its_payload(method: str) -> None:
    coding = payload.upload(load(None, method=method))
    said = coding.encode(np.ones((1, coding.floats)))
    act = Act(0xFFFFFFFF, 2**31, np.zeros((1, 5)))
    batch = Frames(FrameKind.UPLOAD, 2**32 - 1, np.array([99_999], np.int32), said)
    with_it = Act(act.run, act.tick, act.commands, outbox=(batch,))
    assert 8 * said.nbytes == coding.bits
    assert len(tick.write_act(with_it)) - len(tick.write_act(act)) <= 1.10 * said.nbytes


# -- what is damaged ----------------------------------------------------------------------------------------------


def never_worse(raw: bytes) -> None:
    """The one promise to everyone who sends us bytes: a message that says the same to any library, or a rejection."""
    for receiver in (tick.read_sense, tick.read_act):
        try:
            message = receiver(raw)
        except MessageRejected as rejected:
            if rejected.reason not in REASONS:
                raise
            continue
        for array in arrays_in(message):
            assert np.isfinite(array).all()
            assert not array.flags.writeable
        tree = msgpack.unpackb(raw)
        assert msgspec.msgpack.decode(raw) == tree
        assert as_documented(tree) == as_meant(message)
        assert written(message) == raw


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """An honest message, hurt in up to four places: bytes changed, cut out, put in, cut off, spliced with another."""
    honest = [RAW[name] for name in OF_A_TICK]
    raw = bytearray(draw(st.sampled_from(honest)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, min(len(raw), 400)) | st.integers(0, len(raw)))
        how = draw(st.sampled_from(["change", "change", "change", "cut", "insert", "truncate", "splice"]))
        if how == "change" and at < len(raw):
            raw[at] = draw(st.integers(0, 255))
        elif how == "cut":
            del raw[at : at + draw(st.integers(1, 9))]
        elif how == "insert":
            raw[at:at] = draw(st.binary(min_size=1, max_size=9))
        elif how == "truncate":
            del raw[at:]
        elif how == "splice":
            other = draw(st.sampled_from(honest))
            raw[at:] = other[draw(st.integers(0, min(len(other), 400))) :]
    return bytes(raw)


@MANY
@given(damaged())
def test_damaged_bytes_are_a_message_or_are_rejected(raw: bytes) -> None:
    never_worse(raw)


@settings(MANY, max_examples=500)
@given(st.binary(max_size=90) | st.binary(max_size=60).map(lambda tail: RAW["sense"][:24] + tail))
def test_any_bytes_are_a_message_or_are_rejected(raw: bytes) -> None:
    never_worse(raw)


@settings(MANY, max_examples=1000)
@given(damaged())
def test_every_form_lets_in_the_same_and_rejects_for_the_same_reason(backend: Backend, raw: bytes) -> None:
    assert outcome(backend.read, raw) == outcome(REFERENCE.read, raw)


@settings(MANY, max_examples=500)
@given(damaged() | st.sampled_from([RAW[name] for name in OF_A_TICK]), st.integers(0, 3), st.integers(1, 5))
def test_the_first_table_is_written_where_it_is_wanted_or_nowhere(
    backend: Backend, raw: bytes, rows: int, columns: int
) -> None:
    for kind in (SENSE, ACT):
        into = np.full((rows, columns), 7.0)
        got = outcome(backend.read, raw, kind, into)
        assert got == outcome(REFERENCE.read, raw, kind, np.zeros((rows, columns)))
        if isinstance(got, str):
            assert (into == 7.0).all()
        else:
            assert got[0] == kind
            assert got == REFERENCE.read(raw)
            np.testing.assert_array_equal(into, np.frombuffer(raw, "<f8", rows * columns, FIRST).reshape(rows, columns))


@pytest.mark.parametrize(
    "into", [np.zeros((1, 4), "f4"), np.zeros(4), np.zeros((1, 1, 4)), np.zeros((4, 1)).T[:, ::-1]]
)
def test_compiled_code_writes_a_table_only_where_there_is_room_for_it(into: np.ndarray) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    with pytest.raises(ValueError, match=r"."):
        compiled.read(tick.write_sense(Sense(1, 2, np.ones((1, 4)))), SENSE, into)
    assert not into.any()


@pytest.mark.parametrize("name", OF_A_TICK)
def test_every_byte_that_is_changed_is_seen_or_changes_what_is_read(name: str) -> None:
    raw = RAW[name]
    for at in range(len(raw)):
        for byte in (raw[at] ^ 0x01, raw[at] ^ 0x80, 0x00, 0xFF):
            never_worse(raw[:at] + bytes([byte]) + raw[at + 1 :])


@pytest.mark.parametrize("name", OF_A_TICK)
def test_a_message_cut_off_anywhere_is_malformed(name: str) -> None:
    raw = RAW[name]
    for end in range(len(raw)):
        with pytest.raises(MessageRejected) as caught:
            read(raw[:end])
        assert caught.value.reason == "malformed", end


@pytest.mark.parametrize("name", OF_A_TICK)
def test_a_message_followed_by_anything_is_malformed(name: str) -> None:
    for more in (b"\0", b"\xc0", RAW[name]):
        with pytest.raises(MessageRejected, match=r"^malformed"):
            read(RAW[name] + more)


def places(name: str) -> dict[str, int]:
    """Where the numbers that count something stand, by what they count; of the first batch only."""
    _, _, _, _, rows, columns, tables, batches_ = REFERENCE.read(RAW[name])
    assert rows
    assert columns
    *_, source, said, _, links = batches_[0]
    at = {"rows": 15, "bytes of the table": 20, "width": source - 9, "bytes of sources": source - 4}
    at |= {"bytes of payload": said - 4, "bytes of links": links - 4}
    at |= {f"bytes of table {number}": tables[2 * number] - 4 for number in range(len(tables) // 2)}
    return at


COUNTS = [(name, what) for name in OF_A_TICK for what in places(name)]


@pytest.mark.parametrize(("name", "what"), COUNTS)
def test_a_count_that_lies_is_rejected(name: str, what: str) -> None:
    raw, at = RAW[name], places(name)[what]
    (honest,) = struct.unpack_from(">I", raw, at)
    for lie in {0, 1, honest - 1, honest + 1, 2 * honest, 2**16, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1} - {honest, -1}:
        changed = bytearray(raw)
        struct.pack_into(">I", changed, at, lie)
        with pytest.raises(MessageRejected) as caught:
            read(bytes(changed))
        assert caught.value.reason in ("malformed", "wrong-shape"), lie


@pytest.mark.parametrize("name", OF_A_TICK)
@pytest.mark.parametrize("count", [0, 1, 3, 2**15, 2**16 - 1])
def test_a_number_of_batches_that_lies_is_rejected(name: str, count: int) -> None:
    raw, batches_ = RAW[name], REFERENCE.read(RAW[name])[-1]
    if count == len(batches_):
        count += 1
    at = batches_[0][5] - 20
    assert struct.unpack_from(">H", raw, at) == (len(batches_),)
    with pytest.raises(MessageRejected, match=r"^malformed"):
        read(raw[:at] + struct.pack(">H", count) + raw[at + 2 :])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", ["<f2", "<f4", "<f8"])
def test_a_number_that_is_not_finite_is_named_so_wherever_it_is(dtype: str, bad: float) -> None:
    tables = np.zeros((3, 4))
    said = np.zeros((3, 4), dtype)
    for array in (tables, said):
        for where in ((0, 0), (1, 2), (2, 3)):
            array[where] = bad
            batch = Frames(FrameKind.STATE, 0, np.arange(3, dtype=np.int32), said)
            for message in (
                Sense(1, 2, tables, inbox=(batch,)),
                Act(1, 2, tables, outbox=(batch,)),
                Act(1, 2, np.zeros((3, 4)), models=tables, outbox=(batch,)),
            ):
                with pytest.raises(MessageRejected) as caught:
                    read(written(message))
                assert caught.value.reason == "non-finite"
            array[where] = 0.0


@pytest.mark.parametrize("dtype", ["<f2", "<f4", "<f8"])
def test_the_largest_number_of_a_width_is_finite(dtype: str) -> None:
    said = np.full((2, 3), np.finfo(dtype).max, dtype)
    said[1] *= -1
    message = Sense(
        1, 2, np.full((1, 4), np.finfo("f8").max), inbox=(Frames(FrameKind.STATE, 0, np.zeros(2, "<i4"), said),)
    )
    same(read(written(message)), message)


def test_nothing_times_very_many_is_nothing_and_not_worse() -> None:
    head = bytes([0x98, SENSE]) + struct.pack(">BIBIBBIBBI", 0xCE, 1, 0xCE, 2, 0, 0xCE, 2**32 - 1, 0, 0xC6, 0)
    never_worse(head + struct.pack(">BIBH", 0xC6, 0, 0xDC, 0))
    batch = struct.pack(">BBBIBBIBI", 0x97, 2, 0xCE, 0, 2, 0xCE, 2**32 - 1, 0xC6, 0)
    empty = struct.pack(">BI", 0xC6, 0)
    never_worse(head + empty + struct.pack(">BH", 0xDC, 1) + batch + empty + empty)


def test_a_message_of_the_other_type_and_frames_of_no_kind_are_named_so() -> None:
    for receiver, name in ((tick.read_act, "sense"), (tick.read_sense, "act")):
        with pytest.raises(MessageRejected) as caught:
            receiver(RAW[name])
        assert caught.value.reason == "wrong-kind"
    raw = bytearray(RAW["sense"])
    raw[REFERENCE.read(RAW["sense"])[-1][0][5] - 17] = len(FrameKind)
    with pytest.raises(MessageRejected) as caught:
        tick.read_sense(bytes(raw))
    assert caught.value.reason == "wrong-kind"


def test_models_that_are_not_so_many_a_row_are_rejected() -> None:
    table_, bytes_ = np.zeros((2, 4)), bytes(8 * 3)
    raw = kernels.write(ACT, 1, 2, 0, 2, 4, table_, (b"", b"", bytes_, b""))
    with pytest.raises(MessageRejected) as caught:
        tick.read_act(raw)
    assert caught.value.reason == "wrong-shape"
    raw = kernels.write(ACT, 1, 2, 0, 0, 4, b"", (b"", b"", bytes_, b""))
    with pytest.raises(MessageRejected) as caught:
        tick.read_act(raw)
    assert caught.value.reason == "wrong-shape"


@pytest.mark.parametrize("name", sorted(set(RAW) - set(OF_A_TICK)))
def test_a_control_message_is_told_from_one_of_a_tick_by_its_second_byte(name: str) -> None:
    assert RAW[name][1:2] not in tick.TYPES
    for receiver in (tick.read_sense, tick.read_act):
        with pytest.raises(MessageRejected, match=r"^malformed"):
            receiver(RAW[name])
    assert all(RAW[of_a_tick][1:2] in tick.TYPES for of_a_tick in OF_A_TICK)
