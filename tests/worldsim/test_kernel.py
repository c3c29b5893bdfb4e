"""The world's compiled tick gives the bits of NumPy's, whatever the numbers; and what does not fit it is refused."""

import shutil
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from groundstation.engine import Engine
from swarm import state
from swarm.messages import Status
from swarm.scenario import Scenario, load
from worldsim import kernel, physics
from worldsim.metrics import FEW
from worldsim.physics import ARRIVING, BOUND, DIVERGED, Moved, Physics

needs_kernel = pytest.mark.skipif(not kernel.is_compiled(), reason="installed without a C compiler")


def tick_both_ways(flown: Scenario, states: np.ndarray, *given: Any, books: Any = None) -> list[tuple[Any, ...]]:
    """All a tick says and writes, by the kernel and by NumPy."""
    results = []
    for compiled in (True, False):
        written = fresh(states.shape[:-1]) if books is None else tuple(book.copy() for book in books)
        with np.errstate(all="ignore"):
            moved = Physics(flown, compiled=compiled)(states, *given, written)
        results.append((*comparable(moved, given[0]), *(book.tobytes() for book in written)))
    return results


def fresh(shape: tuple[int, ...]) -> physics.Books:
    """Books in which nothing is written yet."""
    return np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.int64)


def comparable(moved: Moved, status: np.ndarray) -> tuple[Any, ...]:
    """Bits, and who collides with whom while both are on the way."""
    on_way = status == Status.FLYING
    pairs = [pair for pair in moved.colliding.tolist() if on_way[*pair[:-1]] and on_way[*pair[:-2], pair[-1]]]
    marks = moved.marks & (DIVERGED | ARRIVING)
    # A NaN is a NaN: its sign and payload mean nothing.
    numbers = [np.where(np.isnan(array), np.nan, array).tobytes() for array in (moved.states, moved.numbers)]
    return (*numbers, marks.tobytes(), moved.incidents & (DIVERGED | ARRIVING), pairs)


def drawn(seed: int, shape: tuple[int, ...], spread: float = 30.0) -> list[np.ndarray]:
    """States, status, accelerations, a gust and noise of UAVs of all kinds."""
    draw = np.random.default_rng(seed)
    states = draw.normal(0, spread, (*shape, state.SIZE))
    status = draw.integers(0, 3, shape).astype(np.uint8)
    return [states, status, *(draw.normal(0, 2, (*shape, 2)) for _ in range(3))]


def test_where_there_is_a_compiler_there_is_a_kernel() -> None:
    headers = Path(sysconfig.get_path("include"), "Python.h")
    assert kernel.is_compiled() or shutil.which("cc") is None or not headers.exists()


@needs_kernel
@pytest.mark.parametrize("gusty", [False, True])
@pytest.mark.parametrize("spread", [30.0, 1.0, 0.05])  # nobody is near, some collide, all do
@pytest.mark.parametrize("shape", [*((n,) for n in (*range(1, 20), 25, FEW, FEW + 1)), (3, 25), (2, 1), (2, 3, 7)])
def test_a_tick_of_the_kernel_is_that_of_numpy(shape: tuple[int, ...], spread: float, gusty: bool) -> None:
    flown = load(None, [f"uavs={shape[-1]}", "wind.sigma=0.7"])
    states, status, accelerations, gust, noise = drawn(len(shape) + shape[-1], shape, spread)
    books = fresh(shape)
    for _ in range(5):
        given = status, accelerations, gust if gusty else None, noise
        compiled, plain = tick_both_ways(flown, states, *given, books=books)
        assert compiled == plain
        states = Physics(flown)(states, *given, books).states


wild = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, width=64),
    st.sampled_from([0.0, -0.0, 1.0, 5.0, 0.1, BOUND, np.nextafter(BOUND, 0.0), -BOUND, 1e-160]),
)


@needs_kernel
@settings(max_examples=150, deadline=None)
@given(
    arrays(np.float64, (2, 5, 4), elements=wild),
    arrays(np.uint8, (2, 5), elements=st.integers(0, 2)),
    arrays(np.float64, (2, 5, 2), elements=wild),
    st.none() | arrays(np.float64, (2, 5, 2), elements=wild),
    arrays(np.float64, (2, 5, 2), elements=st.floats(-6, 6)),
)
def test_numbers_beyond_all_bounds_are_treated_alike(
    states: np.ndarray, status: np.ndarray, accelerations: np.ndarray, gust: np.ndarray | None, noise: np.ndarray
) -> None:
    compiled, plain = tick_both_ways(load(None, ["uavs=5"]), states, status, accelerations, gust, noise)
    assert compiled == plain


@needs_kernel
@settings(max_examples=80, deadline=None)
@given(
    arrays(  # coarse numbers: coincident UAVs, and pairs exactly on either radius, are common
        np.float64,
        st.tuples(st.integers(1, 3), st.integers(1, 30), st.just(state.SIZE)),
        elements=st.sampled_from([0.0, 0.1, 0.25, -0.3, 0.5, 1.0, 4.75, 1e6, 1e6 + 0.25]),
    ),
    st.sampled_from([0.1, 0.25, 0.5]),
    st.sampled_from([0.25, 0.5, 1.0]),
)
def test_pairs_on_a_radius_are_counted_alike(states: np.ndarray, collision: float, hazard: float) -> None:
    n, still = states.shape[1], np.zeros((*states.shape[:-1], 2))
    calm = ["wind.sigma=0", "wind.drag=0", f"metrics.collision_radius={collision}", f"metrics.hazard_radius={hazard}"]
    states[..., state.VELOCITY] = 0.0
    status = (np.arange(states.shape[0] * n).reshape(states.shape[:-1]) % 4 == 0).astype(np.uint8)
    compiled, plain = tick_both_ways(load(None, [f"uavs={n}", *calm]), states, status, still, None, still)
    assert compiled == plain


@needs_kernel
@pytest.mark.parametrize("shape", [(25,), (3, 7)])
def test_what_is_given_stays_as_it_was(shape: tuple[int, ...]) -> None:
    given = drawn(4, shape)
    before = [array.copy() for array in given]
    moved = Physics(load(None, [f"uavs={shape[-1]}"]))(*given, fresh(shape))
    assert not any(np.shares_memory(moved.states, array) for array in given)
    assert all(now.tobytes() == then.tobytes() for now, then in zip(given, before, strict=True))


@needs_kernel
def test_arrays_in_pieces_and_of_other_numbers_are_taken_as_numpy_takes_them() -> None:
    states, status, accelerations, gust, noise = drawn(5, (9,))
    pieces = np.repeat(accelerations, 2, axis=0)[::2].astype(np.float32), np.asfortranarray(gust), noise[::-1]
    compiled, plain = tick_both_ways(load(None, ["uavs=9"]), states, status, *pieces)
    assert compiled == plain


@needs_kernel
@pytest.mark.parametrize(
    ("method", "changes"),
    [
        ("mfgfl-hf", ["uavs=9", "duration=20"]),
        ("hjb", ["uavs=6", "duration=20", "learner.position_scale=40", "learner.velocity_scale=4"]),  # diverges
        ("offline", ["start.centre=[30.0,20.0]", "start.spacing=0.2", "wind.sigma=1.0", "duration=25"]),  # collides
        ("offline", [f"uavs={FEW + 1}", "duration=2"]),
        ("mfg", ["uavs=1", "duration=5"]),
        (
            "offline",
            [
                "duration=8",
                "faults=[{kind='kill',tick=5,uavs=[1]},{kind='gust',tick=9,duration_s=3.0,acceleration=[3.0,-2.0]}]",
            ],
        ),
    ],
)
def test_whole_flights_end_in_the_same_summary(
    method: str, changes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = []
    for _ in range(2):
        engine = Engine(load(None, changes, method=method), "kernel-test")
        for _ in engine.fly():
            pass
        flight, record = engine.world.flight, engine.world.finish()
        kept = {name: value for name, value in flight.snapshot().items() if isinstance(value, np.ndarray)}
        clocks = ("wall_time_s", "real_time_factor")
        ends.append(
            (
                {name: value for name, value in record.items() if name not in clocks},
                {name: array.tobytes() for name, array in kept.items()},
            )
        )
        monkeypatch.setattr(kernel, "_kernel", None)
    assert ends[0] == ends[1]


@needs_kernel
def test_the_same_pairs_collide_without_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    close = ["uavs=12", "start.spacing=0.15", "wind.sigma=0.5", "duration=10"]
    flights = [load(None, close, method="offline", seed=seed) for seed in (1, 2, 3)]
    hashes, collisions = [], []
    for _ in range(2):
        summaries = [Engine(flown, "kernel-test").complete() for flown in flights]
        hashes.append([summary["trajectory_sha256"] for summary in summaries])
        collisions.append([summary["collisions"] for summary in summaries])
        monkeypatch.setattr(kernel, "_kernel", None)
    assert hashes[0] == hashes[1]
    assert collisions[0] == collisions[1] != [0, 0, 0]


def arguments(n: int = 4) -> list[Any]:
    """What the module itself takes: constants, n, whether pairs are measured, and the arrays."""
    outs = [np.full((n, 4), 7.0), *(np.full(n, 7.0) for _ in range(3)), np.full(n, 7), np.full(3, 7.0)]
    made = kernel.Kernel(load(None, [f"uavs={n}"]), BOUND)
    return [made._constants, n, True, *drawn(1, (n,)), *outs, np.full(n, 7, dtype=np.uint8)]


WRONG = [
    (0, b"", "constants"),
    (1, 3, "no swarms"),
    (1, 0, "no swarms"),
    (1, -1, "no swarms"),
    (3, np.zeros((3, 4)), "no swarms|expected"),
    (3, np.zeros((4, 4), dtype=np.float32), "expected|no swarms"),
    (3, np.zeros((8, 4))[::2], "contiguous"),
    (3, np.zeros((4, 4), dtype=np.int64), "format"),
    (4, np.zeros(4), "status"),
    (4, np.zeros(3, dtype=np.uint8), "status"),
    (5, np.zeros((4, 1)), "accelerations"),
    (6, np.zeros((3, 2)), "gust"),
    (7, np.zeros((4, 2), dtype=np.int64), "noise"),
    (8, np.zeros((5, 4)), "moved"),
    (9, np.zeros(3), "energy"),
    (10, np.zeros(4, dtype=np.float32), "distance"),
    (11, np.zeros((4, 2))[:, 0], "contiguous"),
    (12, np.zeros(4, dtype=np.int32), "ticks_on_way"),
    (12, np.zeros(4), "ticks_on_way"),
    (13, np.zeros(2), "numbers"),
    (14, np.zeros(4, dtype=np.int8), "marks"),
    (14, b"1234", "(?i)writable"),
]


@needs_kernel
@pytest.mark.parametrize(("place", "wrong", "said"), WRONG)
def test_what_does_not_fit_is_refused_before_anything_is_written(place: int, wrong: Any, said: str) -> None:
    good = arguments()
    taken = [*good[:place], wrong, *good[place + 1 :]]
    with pytest.raises((ValueError, BufferError), match=said):
        kernel._kernel.advance(*taken)
    assert all((np.asarray(array) == 7).all() for k, array in enumerate(good[8:], 8) if k != place)


@needs_kernel
def test_nothing_is_written_beyond_the_last_uav() -> None:
    """The arrays given are the beginnings of longer ones."""
    for n in (1, 3, 4, 5, 25):
        good = arguments(n)
        longer = [np.concatenate([array, array]) for array in good[8:]]
        given = [array[: len(array) // 2] for array in longer]
        kernel._kernel.advance(*good[:8], *given)
        assert all((array[len(array) // 2 :] == 7).all() for array in longer)
        assert not (given[0] == 7).any()


@needs_kernel
def test_no_uavs_are_no_work() -> None:
    empty = [np.zeros((0, array.shape[1])) if array.ndim == 2 else array[:0] for array in arguments()[3:]]
    assert kernel._kernel.advance(arguments()[0], 4, True, *empty) == 0
