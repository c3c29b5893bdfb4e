"""The messages of a tick: what goes in comes out, and every library reads it."""

from collections.abc import Callable
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.federation import coding as codings
from meanflock.kernels.wire import ACT, DTYPES, FIRST, SENSE
from meanflock.swarm.scenario import load
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense
from tests.swarm.backends import Backend
from tests.swarm.examples import arrays_in, same
from tests.swarm.ticks import QUICK, acts, as_documented, as_meant, batches, read, senses, written

pytestmark = pytest.mark.usefixtures("backend")  # all of this holds for every form


@QUICK
@given(st.one_of(senses, acts()))
def test_a_message_is_read_as_it_was_written_and_its_arrays_cannot_be_written_to(message: Sense | Act) -> None:
    received = read(written(message))
    same(received, message)
    for array in arrays_in(received):
        assert not array.flags.writeable


@pytest.mark.parametrize("unpack", [msgpack.unpackb, msgspec.msgpack.decode], ids=["msgpack", "msgspec"])
def test_other_libraries_read_every_field(unpack: Callable[[bytes], Any]) -> None:
    @QUICK
    @given(st.one_of(senses, acts()))
    def check(message: Sense | Act) -> None:
        assert as_documented(unpack(written(message))) == as_meant(message)

    check()


def test_the_first_numbers_are_aligned_and_numbers_of_any_memory_order_travel_as_their_values() -> None:
    grid = np.arange(24.0).reshape(4, 6)
    for view in (grid[:, 1:5], grid.T, grid[::-2], grid.astype(np.float32)):
        raw = tick.write_sense(Sense(1, 2, view))
        np.testing.assert_array_equal(tick.read_sense(raw).states, view)
        assert raw[FIRST : FIRST + 8 * view.size] == view.astype("<f8").tobytes()
    assert FIRST % 8 == 0


def test_numbers_of_uavs_of_any_type_travel_as_32_bits() -> None:
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
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, 0, 2, bytes(5), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(128, 0, 0, 2, bytes(4), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, len(DTYPES), 2, bytes(4), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 2**32, 0, 2, bytes(4), bytes(4), b"")]),
    ],
)
def test_a_message_that_does_not_fit_the_layout_is_not_written(backend: Backend, given_: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=r"^wrong-shape"):
        backend.write(*given_)


def test_the_size_of_a_batch_in_a_message_is_known_beforehand() -> None:
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
    coding = codings.of_uploads(load(None, method=method))
    said = coding.encode(np.ones((1, coding.floats)))
    act = Act(0xFFFFFFFF, 2**31, np.zeros((1, 5)))
    batch = Frames(FrameKind.UPLOAD, 2**32 - 1, np.array([99_999], np.int32), said)
    with_it = Act(act.run, act.tick, act.commands, outbox=(batch,))
    assert 8 * said.nbytes == coding.bits
    assert len(tick.write_act(with_it)) - len(tick.write_act(act)) <= 1.10 * said.nbytes
