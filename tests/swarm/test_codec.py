"""Control messages are read as they were written, and their bytes do not change."""

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Sense
from tests.swarm.examples import DTYPES, EXAMPLES, GOLDEN, TYPES, arrays_in, read, same, written

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


st.register_type_strategy(np.ndarray, arrays())
st.register_type_strategy(int, st.integers(-(2**63), 2**64 - 1))


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
@given(st.dictionaries(st.text(max_size=5), st.one_of(arrays(), st.binary(max_size=9), st.integers(-9, 9), st.none())))
def test_a_record_is_read_as_it_was_written(record: dict[str, Any]) -> None:
    read = control.decode_record(control.encode_record(record))
    assert set(read) == set(record)
    for name, value in record.items():
        same(read[name], value)


@pytest.mark.parametrize("other", [[], {3: 4}])
def test_a_value_that_is_no_record_is_malformed(other: Any) -> None:
    with pytest.raises(MessageRejected, match=r"^malformed"):
        control.decode_record(msgpack.packb(other))


def test_there_is_an_example_of_every_message() -> None:
    assert {type(message) for message in EXAMPLES.values()} == {*TYPES, Sense, Act}
    assert {path.stem for path in GOLDEN.glob("*.bin")} == set(EXAMPLES)


@pytest.mark.usefixtures("backend")
@pytest.mark.parametrize("name", EXAMPLES)
def test_the_golden_bytes_are_written_and_read(name: str) -> None:
    golden = (GOLDEN / f"{name}.bin").read_bytes()
    assert written(EXAMPLES[name]) == golden
    same(read(golden), EXAMPLES[name])
