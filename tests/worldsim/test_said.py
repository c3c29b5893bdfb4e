"""What nodes said, taken apart and entered by the kernel as without it."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from swarm import codec, plain
from swarm.messages import Act, FrameKind, Frames
from tests.worldsim.test_kernel import needs_kernel
from worldsim import kernel

NOT_ENTERED = [
    ([b"1" * 41], "item 0"),
    ([b"1" * 40, "x" * 40], "item 1"),
    ([np.zeros(5)], "item 0"),
    ([b"1" * 40], "expected 2 doubles"),
    ([b"1" * 40] * 3, "expected 6 doubles"),
    ([], "expected 0 doubles"),
]


@needs_kernel
@pytest.mark.parametrize(("said", "why"), NOT_ENTERED)
def test_outcomes_that_do_not_fit_are_not_entered(said: list[Any], why: str) -> None:
    accelerations, diagnostics = np.full((2, 2), 7.0), np.full((2, 3), 7.0)
    with pytest.raises(ValueError, match=why):
        kernel._kernel.enter(said, 1e9, accelerations, diagnostics)
    assert (accelerations == 7).all()
    assert (diagnostics == 7).all()


@needs_kernel
@pytest.mark.parametrize(
    ("accelerations", "diagnostics"),
    [
        (np.zeros((2, 2)), np.zeros((2, 2))),
        (np.zeros((2, 2)), np.zeros((2, 3), dtype=np.int64)),
        (np.zeros((2, 2), dtype=np.float32), np.zeros((2, 3))),
        (np.zeros((4, 2))[::2], np.zeros((2, 3))),
        (np.zeros((2, 2)), bytes(48)),
        (np.zeros((2, 2)), None),
    ],
)
def test_outcomes_are_entered_only_where_there_is_room(accelerations: Any, diagnostics: Any) -> None:
    with pytest.raises((ValueError, BufferError, TypeError)):
        kernel._kernel.enter([b"1" * 80], 1e9, accelerations, diagnostics)
    assert not np.asarray(accelerations).any()


@needs_kernel
@given(
    st.lists(st.integers(0, 4), max_size=6),
    st.integers(0, 2**32),
    st.sampled_from([0.0, np.nan, np.inf, -np.inf, 10.0, -10.0, np.nextafter(10.0, 0.0)]),
)
def test_outcomes_are_entered_in_their_order_or_not_at_all(rows: list[int], seed: int, wild: float) -> None:
    numbers = np.random.default_rng(seed).normal(0, 2, (sum(rows), 5)).clip(-9, 9)
    if len(numbers):
        numbers[seed % len(numbers), seed % 5] = wild
    said = [part.tobytes() for part in np.split(numbers, np.cumsum(rows)[:-1])] if rows else []
    accelerations, diagnostics = np.full((len(numbers), 2), 7.0), np.full((len(numbers), 3), 7.0)
    largest = kernel.enter(said, 10.0, accelerations, diagnostics)
    if len(numbers) and not abs(wild) < 10.0:
        assert largest is None
        assert (accelerations == 7).all()
        assert (diagnostics == 7).all()
    else:
        assert largest == tuple(np.abs(numbers[:, 2:4]).max(axis=0, initial=0.0).tolist())
        assert (np.concatenate([accelerations, diagnostics], axis=-1) == numbers).all()


numbers = arrays(np.float64, st.tuples(st.integers(1, 4), st.just(5)), elements=st.floats(width=64))
payloads = st.sampled_from(["<f2", "<f4", "<f8"]).flatmap(
    lambda kind: arrays(kind, (1, 6), elements=st.floats(width=8 * np.dtype(kind).itemsize))
)


@needs_kernel
@given(
    numbers, payloads, st.binary(max_size=40), st.integers(0, 250), st.sampled_from(["", "cut", "longer", "damaged"])
)
def test_an_answer_is_split_as_without_the_kernel(
    outcome: np.ndarray, payload: np.ndarray, noise: bytes, at: int, how: str
) -> None:
    uploads = plain.uploads(3, len(outcome), False, (payload.shape, payload.dtype))
    outbox = (Frames(FrameKind.UPLOAD, 7, np.array([-1], np.int32), payload),)  # whose bytes are no finite float
    for kind, act in (
        (plain.acts(3, len(outcome)), Act(3, 300, outcome)),
        (uploads, Act(3, 300, outcome, outbox=outbox)),
    ):
        good = codec.encode(act)
        damaged = good[:at] + noise + good[at + len(noise) :]
        raw = {"": good, "cut": good[:at], "longer": good + noise, "damaged": damaged}[how]
        told = kernel.splitter(kind, 300, 7)(raw)
        assert told == kind.split(300, raw, 7)
        assert told is not None or how or not np.isfinite([*outcome.flat, *payload.flat]).all()
        assert how == "damaged" or kernel.splitter(kind, 301, 7)(raw) is None


@needs_kernel
@pytest.mark.parametrize(
    "given",
    [
        (),
        ([b"", b""], (1,), b"d", b""),
        ((b"", b""), [1], b"d", b""),
        ((b"", b""), (1,), "d", b""),
        ((b"", b""), (1,), b"d", bytearray()),
        ((b"", ""), (1,), b"d", b"\0"),
        ((b"", b""), ("1",), b"d", b""),
        ((b"", b""), (2**70,), b"d", b""),
        ((b"",), (1,), b"d", b""),
        ((b"", b""), (1,), b"dd", b""),
        ((), (), b"", b""),
    ],
)
def test_what_splits_answers_takes_nothing_else(given: tuple[Any, ...]) -> None:
    with pytest.raises((TypeError, ValueError, OverflowError)):
        kernel._kernel.split(*given)


@needs_kernel
def test_what_splits_answers_reads_nothing_beyond_their_end() -> None:
    split = kernel._kernel.split
    assert split((b"ab", b"c"), (8,), b"d", b"abc") is None
    assert split((b"ab", b"c"), (-3,), b"d", b"") is None
    assert split((b"ab", b"bc"), (-1,), b"d", b"abc") is None
    assert split((b"ab", b"c"), (2**62,), b"d", b"abc") is None
    assert split((b"ab", b"c"), (7,), b"d", b"ab\xff\xff\xff\xff\xff\xff\xffc") == (b"\xff" * 7,)
    assert split((b"abc",), (), b"", b"abc") == ()
