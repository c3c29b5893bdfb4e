"""Hostile bytes: every reader accepts messages and rejects all else with a reason, in both forms of the kernels."""

import struct
from collections.abc import Callable, Sequence
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.kernels.wire import ACT, SENSE
from meanflock.net import tick
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Ready, Sense, Welcome
from tests.fuzz.mutation import Mutator
from tests.swarm.conftest import REFERENCE, Backend, outcome
from tests.swarm.examples import DTYPES, EXAMPLES, OF_A_TICK, RAW, TYPES, arrays_in, read, same, written
from tests.swarm.ticks import QUICK, as_documented


def damaged(honest: Sequence[bytes]) -> st.SearchStrategy[bytes]:
    """Honest messages, mutated in up to three places."""
    return st.integers(0, 2**32 - 1).map(lambda seed: Mutator(honest, seed)(2))


pytestmark = pytest.mark.usefixtures("backend")

MANY = settings(QUICK, max_examples=500)
HONEST = list(RAW.values())
TICKS = [RAW[name] for name in OF_A_TICK]
REASONS = {"malformed", "oversized", "wrong-shape", "non-finite", "wrong-kind"}
RECEIVERS = (control.decode, tick.read_sense, tick.read_act)


def check(raw: bytes) -> None:
    """Checks the promise of all readers: a message that other libraries read alike, or a rejection with a reason."""
    for receiver in RECEIVERS:
        try:
            message: Any = receiver(raw)
        except MessageRejected as rejected:
            if rejected.reason not in REASONS:
                raise
            continue
        for array in arrays_in(message):
            assert np.isfinite(array).all()
            assert not array.flags.writeable
        if isinstance(message, Sense | Act):
            tree = msgpack.unpackb(raw)
            assert msgspec.msgpack.decode(raw) == tree
            same(as_documented(tree), message)
            assert written(message) == raw
        else:
            assert isinstance(message, TYPES)
            same(control.decode(control.encode(message)), message)


def rejects(reason: str, receiver: Callable[..., Any], *given_: Any) -> None:
    with pytest.raises(MessageRejected) as caught:
        receiver(*given_)
    assert caught.value.reason in reason.split()


# -- any damage, any reader ---------------------------------------------------------------------------------------


@MANY
@given(damaged(HONEST) | st.binary(max_size=90) | st.binary(max_size=60).map(lambda tail: RAW["sense"][:24] + tail))
def test_damaged_bytes_are_a_message_or_are_rejected(raw: bytes) -> None:
    check(raw)


@pytest.mark.parametrize("name", OF_A_TICK)
def test_a_changed_byte_is_rejected_or_changes_the_message(name: str) -> None:
    message = EXAMPLES[name]
    if isinstance(message, Act):
        message = msgspec.structs.replace(message, models=np.ones((2, 3)))  # a shorter message, of the same parts
    raw = written(message)
    for at in range(len(raw)):
        for byte in (raw[at] ^ 0x01, raw[at] ^ 0x04, raw[at] ^ 0x80, 0x00, 0xFF):
            check(raw[:at] + bytes([byte]) + raw[at + 1 :])
        for count in (0, 2**16, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1):  # where a count of 32 bits may be
            check(raw[:at] + struct.pack(">I", count) + raw[at + 4 :])


@pytest.mark.parametrize("name", RAW)
def test_a_message_that_is_cut_off_or_followed_by_more_is_malformed(name: str) -> None:
    raw = RAW[name]
    for end in range(len(raw)):
        rejects("malformed" if name in OF_A_TICK else "malformed wrong-shape", read, raw[:end])
    for more in (b"\0", b"\xc0", raw):
        rejects("malformed", read, raw + more)


@pytest.mark.parametrize("name", OF_A_TICK)
def test_a_message_in_another_form_of_messagepack_is_malformed(name: str) -> None:
    raw = RAW[name]
    assert raw[7] == 0xCE
    signed = raw[:7] + b"\xd2" + raw[8:]  # a number of as many bytes, with a sign
    for other in (signed, msgpack.packb(msgpack.unpackb(raw))):
        assert msgpack.unpackb(other) == msgpack.unpackb(raw)
        rejects("malformed", read, other)


def test_very_many_rows_of_no_width_are_a_message_or_are_rejected() -> None:
    head = bytes([0x98, SENSE]) + struct.pack(">BIBIBBIBBI", 0xCE, 1, 0xCE, 2, 0, 0xCE, 2**32 - 1, 0, 0xC6, 0)
    check(head + struct.pack(">BIBH", 0xC6, 0, 0xDC, 0))
    batch = struct.pack(">BBBIBBIBI", 0x97, 2, 0xCE, 0, 2, 0xCE, 2**32 - 1, 0xC6, 0)
    empty = struct.pack(">BI", 0xC6, 0)
    check(head + empty + struct.pack(">BH", 0xDC, 1) + batch + empty + empty)


def test_a_message_of_another_type_is_rejected() -> None:
    rejects("wrong-kind", tick.read_act, RAW["sense"])
    rejects("wrong-kind", tick.read_sense, RAW["act"])
    raw = bytearray(RAW["sense"])
    raw[raw.index(b"\xdc") + 4] = len(FrameKind)  # behind the count of batches and the head of the first
    rejects("wrong-kind", tick.read_sense, bytes(raw))
    for name in set(RAW) - set(OF_A_TICK):
        assert RAW[name][1:2] not in tick.TYPES
        rejects("malformed", tick.read_sense, RAW[name])
        rejects("malformed", tick.read_act, RAW[name])


# -- the forms of the reader --------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [-1, 7, 8, 2**31 - 1])
@pytest.mark.parametrize("place", ["source", "row", "receiver"])
def test_frames_name_uavs_of_the_swarm_and_rows_of_their_payload(backend: Backend, place: str, number: int) -> None:
    source, links = np.array([0, 7], "<i4"), np.array([[0, 7], [1, 0]], "<i4")
    if place == "source":
        source[1] = number
    else:
        links[1, int(place == "receiver")] = number
    frames = Frames(FrameKind.STATE, 0, source, np.zeros((2, 3), "<f4"), links)
    raw = tick.write_sense(Sense(1, 2, np.zeros((1, 4)), inbox=(frames,)))
    is_good = number == 7 and place != "row"
    assert outcome(backend.read, raw, SENSE, None, 8) == (REFERENCE.read(raw) if is_good else "wrong-shape")
    assert outcome(backend.read, raw, SENSE, None, 0) == REFERENCE.read(raw)


@MANY
@given(damaged(TICKS) | st.sampled_from(TICKS), st.integers(0, 3), st.integers(1, 5))
def test_every_form_accepts_the_same_and_writes_the_first_table_where_wanted(backend, raw, rows, columns) -> None:
    for uavs in (0, 5):
        assert outcome(backend.read, raw, 0, None, uavs) == outcome(REFERENCE.read, raw, 0, None, uavs)
    for kind in (SENSE, ACT):
        into = np.full((rows, columns), 7.0)
        got = outcome(backend.read, raw, kind, into)
        assert got == outcome(REFERENCE.read, raw, kind, np.zeros((rows, columns)))
        if isinstance(got, str):
            assert (into == 7.0).all()
        else:
            assert got[0] == kind
            assert got == REFERENCE.read(raw)
            assert into.tobytes() == got[6]


@pytest.mark.parametrize(
    "into", [np.zeros((1, 4), "f4"), np.zeros(4), np.zeros((1, 1, 4)), np.zeros((4, 1)).T[:, ::-1]]
)
def test_compiled_code_writes_a_table_only_where_there_is_room_for_it(into: np.ndarray) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    with pytest.raises(ValueError, match=r"."):
        compiled.read(tick.write_sense(Sense(1, 2, np.ones((1, 4)))), SENSE, into)
    assert not into.any()


# -- control messages ---------------------------------------------------------------------------------------------


def message_with(array: bytes, extension: int = 1) -> bytes:
    return msgspec.msgpack.encode(["welcome", 1, "agent-0", [0], 2, b"{}", msgspec.msgpack.Ext(extension, array)])


def header(kind: int, shape: tuple[int, ...], axes: int | None = None) -> bytes:
    return struct.pack(f"<BB{len(shape)}I", kind, len(shape) if axes is None else axes, *shape)


MAX = 2**32 - 1
F8 = 2
HONEST_ARRAY = header(F8, (1, 4)) + bytes(32)
WELCOME = ["welcome", 1, "agent-0", [0], 2, b"{}", [[0.0] * 4]]
TREES: tuple[Any, ...] = (
    ["ready", 1, 2],
    ["ready", "1"],
    ["ready", None],
    ["nobody", 1],
    WELCOME,
    ["sense", 1],
    [],
    {},
)
MALFORMED: dict[str, bytes] = {
    "nested arrays": b"\x91" * 100_000,
    "nested maps": b"\x81\xa1a" * 100_000,
    **{repr(tree): msgpack.packb(tree) for tree in TREES},
    **{f"extension {code}": message_with(HONEST_ARRAY, code) for code in (0, 2, -1)},
    "an array without a header": message_with(b""),
    "half a header": message_with(b"\x02"),
    "an unknown dtype": message_with(header(len(DTYPES), (1,)) + bytes(8)),
    "six axes": message_with(header(F8, (1, 1, 1, 1, 1, 1)) + bytes(8)),
    "axes cut off": message_with(header(F8, (1,), axes=3)),
}
WRONG_SHAPE = {
    "too little": header(F8, (1, 4)) + bytes(31),
    "too much": header(F8, (1, 4)) + bytes(33),
    "nothing of a scalar": header(F8, ()),
    "product is 2⁶⁴": header(F8, (2**31, 2**31, 4)),
    "product is 2³²": header(4, (2**16, 2**16)),
    "−1 of rows": header(F8, (MAX, 4)) + bytes(32),
}


def test_a_control_message_of_another_form_is_rejected_for_its_reason() -> None:
    assert isinstance(control.decode(message_with(HONEST_ARRAY)), Welcome)
    for raw in MALFORMED.values():
        rejects("malformed", control.decode, raw)
    for array in WRONG_SHAPE.values():
        rejects("wrong-shape", control.decode, message_with(array))


def test_bytes_beyond_the_limit_are_oversized_and_are_not_parsed() -> None:
    rejects("oversized", control.decode, b"\xc1" * 101, 100)
    rejects("oversized", control.decode, bytes(control.MAX_BYTES + 1))
    raw = RAW["ready"]
    assert isinstance(control.decode(raw, limit=len(raw)), Ready)
