"""The messages of a tick are read as they were written, by us and by other libraries."""

from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.kernels.wire import ACT, DTYPES, FIRST, SENSE
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, Frames, Sense
from tests.swarm.backends import Backend
from tests.swarm.examples import arrays_in, read, same, written
from tests.swarm.ticks import QUICK, acts, as_documented, batches, senses

pytestmark = pytest.mark.usefixtures("backend")  # all of this holds for every form


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


@QUICK
@given(batches())
def test_the_size_of_a_batch_in_a_message_is_known_beforehand(batch: Frames) -> None:
    silent = Frames(batch.kind, batch.round, batch.source, batch.payload)
    without, with_it = (tick.write_sense(Sense(1, 2, np.zeros((1, 4)), inbox=inbox)) for inbox in ((), (silent,)))
    assert tick.bytes_of_batch(silent) == len(with_it) - len(without)


def test_the_first_numbers_are_aligned_and_numbers_of_any_memory_order_travel_as_their_values() -> None:
    grid = np.arange(24.0).reshape(4, 6)
    for view in (grid[:, 1:5], grid.T, grid[::-2], grid.astype(np.float32)):
        raw = tick.write_sense(Sense(1, 2, view))
        np.testing.assert_array_equal(tick.read_sense(raw).states, view)
        assert raw[FIRST : FIRST + 8 * view.size] == view.astype("<f8").tobytes()
    assert FIRST % 8 == 0
    got = tick.read_act(tick.write_act(Act(1, 2, grid, lost=np.array([4, 6]), refused=np.array([1], np.int16))))
    assert (got.lost.tolist(), got.refused.tolist()) == ([4, 6], [1])  # numbers of UAVs travel as 32 bits


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
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 0, len(DTYPES), 2, bytes(4), bytes(4), b"")]),
        (SENSE, 1, 1, 0, 0, 0, b"", (b"",), [(0, 2**32, 0, 2, bytes(4), bytes(4), b"")]),
    ],
)
def test_a_message_that_does_not_fit_the_layout_is_not_written(backend: Backend, given_: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=r"^wrong-shape"):
        backend.write(*given_)
