"""All pairs of a swarm: both forms against the plain matrix of all pairs, and what does not fit is refused."""

import math
import tracemalloc
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meanflock.kernels.reference import FEW
from meanflock.swarm import state

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def measured(
    backend: ModuleType, states: np.ndarray, hazard: float, collision: float
) -> tuple[float, int, list[Any], float]:
    found = np.full((len(states) ** 2 + 1, 2), -7)
    mean, near, count, nearest = backend.pairs(states, hazard, collision, found)
    assert (found[count:] == -7).all()
    return mean, near, found[:count].tolist(), nearest


def by_the_matrix(states: np.ndarray, hazard: float, collision: float) -> tuple[np.ndarray, int, list[Any], float]:
    """The N × N distances of velocities, the number of near pairs, the touching ones, and the least distance."""
    difference = states[:, None] - states[None]
    squared = difference[..., state.X] ** 2 + difference[..., state.Y] ** 2
    speeds = np.sqrt(difference[..., state.VX] ** 2 + difference[..., state.VY] ** 2)
    close, touching = np.triu(squared <= hazard * hazard, 1), np.triu(squared < collision * collision, 1)
    nearest = math.sqrt(squared[np.triu_indices(len(states), 1)].min(initial=math.inf))
    return speeds, int(close.sum()), np.argwhere(touching).tolist(), nearest


coarse = st.sampled_from([0.0, 0.1, 0.25, -0.3, 0.5, 1.0, -7.75, 1e-160, 1e6, 1e6 + 0.25])


@both_forms
@given(
    arrays(np.float64, st.tuples(st.integers(1, 40), st.just(state.SIZE)), elements=coarse),
    st.sampled_from([1e-3, 0.25, 0.5, math.sqrt(0.5), 1.0]),
    st.sampled_from([1e-3, 0.1, 0.25, 2.0]),
    st.booleans(),
)
def test_pairs_are_those_of_the_matrix(
    backend: ModuleType, states: np.ndarray, hazard: float, collision: float, large: bool
) -> None:
    """Coincident UAVs, and pairs exactly on either radius, are common; a large swarm is a small one many times."""
    states = np.tile(states, (1 + FEW // len(states), 1)) if large else states
    mean, near, touching, nearest = measured(backend, states, hazard, collision)
    speeds, all_near, all_touching, least = by_the_matrix(states, hazard, collision)
    assert (near, touching, nearest) == (all_near, all_touching, least)
    assert mean == pytest.approx(speeds.mean(), rel=1e-12)
    if len(states) <= FEW:
        assert mean == speeds.ravel().sum() / len(states) ** 2


@pytest.mark.parametrize("uavs", [0, 1, 2, 5, 25, FEW - 1, FEW, FEW + 1, 333])
@pytest.mark.parametrize("spread", [300.0, 3.0, 0.03])  # nobody is near, some are, all are
def test_both_forms_give_the_same_bits(uavs: int, spread: float) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    from meanflock.kernels import reference

    draw = np.random.default_rng(uavs)
    states = draw.normal(size=(uavs, state.SIZE)) * [spread, spread, 1.0, 1e-9] + [150.0, 100.0, 12.0, -7.0]
    assert measured(compiled, states, 0.7, 0.1) == measured(reference, states, 0.7, 0.1)


def test_numbers_beyond_all_bounds_are_nobody_s_neighbours(backend: ModuleType) -> None:
    states = np.zeros((4, state.SIZE))
    states[0], states[1, state.X], states[2, state.Y] = np.nan, np.inf, 1e200
    with np.errstate(all="ignore"):
        mean, near, touching, nearest = measured(backend, states, 1.0, 1.0)
    assert (math.isnan(mean), near, touching, nearest) == (True, 0, [], math.inf)


def test_there_may_be_more_pairs_than_room(backend: ModuleType) -> None:
    found = np.full((3, 2), -7)
    states = np.zeros((6, state.SIZE))
    for room, expected in ((found[:2], [[0, 1], [0, 2], [-7, -7]]), (found[:0], [[0, 1], [0, 2], [-7, -7]])):
        assert backend.pairs(states, 1.0, 1.0, room) == (0.0, 15, 15, 0.0)
        assert found.tolist() == expected


def test_a_large_swarm_needs_no_room_for_all_its_pairs(backend: ModuleType) -> None:
    states = np.random.default_rng(6).normal(size=(2000, state.SIZE)) * [100.0, 100.0, 1.0, 1.0]
    tracemalloc.start()
    try:
        backend.pairs(states, 0.7, 0.1, np.empty((64, 2), dtype=np.intp))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * 2**20 < 8 * 2000**2


FOUND = np.zeros((2, 2), dtype=np.intp)
READ_ONLY = np.zeros((2, 2), dtype=np.intp)
READ_ONLY.flags.writeable = False


@pytest.mark.parametrize(
    ("states", "found", "said"),
    [
        (np.zeros(3), FOUND, "states: 24 bytes"),
        (np.zeros((2, 4), np.float32), FOUND, "states: format f"),
        (np.zeros((2, 4), np.int64), FOUND, "states: format"),
        (np.zeros((4, 2)).T, FOUND, "contiguous"),
        (np.zeros((2, 8))[:, ::2], FOUND, "contiguous"),
        (np.zeros((2, 4)), np.zeros((2, 2)), "found: format d"),
        (np.zeros((2, 4)), np.zeros(3, dtype=np.intp), "found: 24 bytes"),
        (np.zeros((2, 4)), np.zeros((2, 2), dtype=np.int32), "found: format i"),
        (np.zeros((2, 4)), READ_ONLY, "(?i)read-only|writable"),
        ([0.0] * 4, FOUND, "bytes-like"),
    ],
)
def test_what_does_not_fit_is_refused(states: Any, found: Any, said: str) -> None:
    native = pytest.importorskip("meanflock.kernels._native")
    with pytest.raises((TypeError, ValueError, BufferError), match=said):
        native.pairs(states, 1.0, 1.0, found)


def test_arrays_may_begin_anywhere() -> None:
    native = pytest.importorskip("meanflock.kernels._native")
    states = np.random.default_rng(1).normal(size=(5, state.SIZE))
    odd = np.frombuffer(b"." + states.tobytes(), dtype=np.float64, offset=1).reshape(5, state.SIZE)
    found, room = np.zeros((10, 2), dtype=np.intp), bytearray(161)
    odd_found = np.frombuffer(room, dtype=np.intp, offset=1).reshape(10, 2)
    assert native.pairs(states, 1.0, 2.0, found) == native.pairs(odd, 1.0, 2.0, odd_found)
    np.testing.assert_array_equal(found, odd_found)
