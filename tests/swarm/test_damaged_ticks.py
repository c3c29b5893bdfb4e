"""A message of a tick that is damaged, or lies, is rejected with the reason, by every form of the reader."""

import struct

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock import kernels
from meanflock.kernels.wire import ACT, FIRST, SENSE
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense
from tests.swarm.backends import BACKENDS, REFERENCE, Backend, outcome
from tests.swarm.damage import damaged
from tests.swarm.examples import OF_A_TICK, RAW, arrays_in, same
from tests.swarm.ticks import QUICK, as_documented, as_meant, read, written

pytestmark = pytest.mark.usefixtures("backend")  # all of this holds for every form

MANY = settings(QUICK, max_examples=2000)
HONEST = [RAW[name] for name in OF_A_TICK]
REASONS = {"malformed", "wrong-shape", "non-finite", "wrong-kind"}


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


@MANY
@given(damaged(HONEST))
def test_damaged_bytes_are_a_message_or_are_rejected(raw: bytes) -> None:
    never_worse(raw)


@settings(MANY, max_examples=500)
@given(st.binary(max_size=90) | st.binary(max_size=60).map(lambda tail: RAW["sense"][:24] + tail))
def test_any_bytes_are_a_message_or_are_rejected(raw: bytes) -> None:
    never_worse(raw)


@pytest.mark.parametrize("backend", [name for name in BACKENDS if BACKENDS[name] != REFERENCE], indirect=True)
@settings(MANY, max_examples=1000)
@given(damaged(HONEST))
def test_every_form_lets_in_the_same_and_rejects_for_the_same_reason(backend: Backend, raw: bytes) -> None:
    assert outcome(backend.read, raw) == outcome(REFERENCE.read, raw)


@settings(MANY, max_examples=500)
@given(damaged(HONEST) | st.sampled_from([RAW[name] for name in OF_A_TICK]), st.integers(0, 3), st.integers(1, 5))
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
