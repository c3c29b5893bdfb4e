"""Pairs of a swarm, and their mean difference of velocities: both forms against plain sums over all pairs."""

import math
import tracemalloc
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meanflock.kernels import reference
from meanflock.kernels.all_pairs import FEW as SMALL
from meanflock.kernels.all_pairs import MANY
from meanflock.kernels.differences import ALIGNMENT_ERROR, FEW
from meanflock.swarm import state

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def measured(
    backend: ModuleType, before: np.ndarray, after: np.ndarray, *bounds: float
) -> tuple[int, list[Any], float]:
    """`bounds`: the radii of hazards and of collisions, and the least distance so far."""
    found = np.full((len(after) ** 2 + 1, 2), -7)
    near, count, nearest = backend.pairs(before, after, *bounds, found)
    assert (found[count:] == -7).all()
    return near, found[:count].tolist(), nearest


def distances(states: np.ndarray) -> np.ndarray:
    """The squared distances of all pairs, N × N."""
    places = state.position(states)
    return state.squared(state.parts(places[:, None] - places[None]))


coarse = st.sampled_from([0.0, 0.1, 0.25, -0.3, 0.5, 1.0, -7.75, 1e-160, 1e6, 1e6 + 0.25])
swarms = arrays(np.float64, st.tuples(st.integers(1, 40), st.sampled_from([4, 6])), elements=coarse)


@both_forms
@given(
    swarms,
    st.sampled_from([1e-3, 0.25, 0.5, math.sqrt(0.5), 1.0]),
    st.sampled_from([1e-3, 0.1, 0.25, 2.0]),
    st.booleans(),
)
def test_pairs_at_rest_are_those_of_the_matrix(
    backend: ModuleType, states: np.ndarray, hazard: float, collision: float, large: bool
) -> None:
    """Coincident UAVs, and pairs exactly on either radius, are common; a large swarm is a small one many times."""
    states = np.tile(states, (1 + SMALL // len(states), 1)) if large else states
    squared = distances(states)
    near, touching, nearest = measured(backend, states, states, hazard, collision, math.inf)
    assert near == np.triu(squared <= hazard * hazard, 1).sum()
    assert touching == np.argwhere(np.triu(squared < collision * collision, 1)).tolist()
    assert nearest == math.sqrt(squared[np.triu_indices(len(states), 1)].min(initial=math.inf))


def closest_approaches(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The least distance of all pairs on straight segments, in extended precision; N × N, infinite but above the
    diagonal."""
    first, last = (state.position(states).astype(np.longdouble) for states in (before, after))
    one, other = np.triu_indices(len(first), 1)
    apart, moved = first[one] - first[other], (last - first)[one] - (last - first)[other]
    length = (moved**2).sum(axis=-1)
    share = np.clip(-(apart * moved).sum(axis=-1) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
    at = apart + share[..., None] * moved
    least = np.full((len(first), len(first)), np.inf, dtype=np.longdouble)
    least[one, other] = np.sqrt((at**2).sum(axis=-1))
    return least


@both_forms
@given(
    st.integers(0, 400),
    st.sampled_from([0.02, 0.3, 3.0, 100.0]),
    st.sampled_from([0.0, 0.05, 1.0, 40.0]),
    st.sampled_from([0.1, 1.0]),
    st.sampled_from([math.inf, 0.2, 1e-3]),
    st.booleans(),
    st.sampled_from([2, 3]),
    st.integers(0, 2**32 - 1),
)
def test_pairs_in_motion_are_those_of_all_closest_approaches_in_both_forms_alike(
    backend: ModuleType,
    uavs: int,
    spread: float,
    step: float,
    collision: float,
    bound: float,
    grid: bool,
    axes: int,
    seed: int,
) -> None:
    """Some UAVs have no segment, some are left out; on a grid many have the same x."""
    draw = np.random.default_rng(seed)
    before = draw.normal(size=(uavs, 2 * axes)) * spread
    before = np.rint(before / spread) * spread if grid else before
    after = before + draw.normal(size=before.shape) * step
    before[draw.random(uavs) < 0.1] = np.nan
    after[draw.random(uavs) < 0.1] = np.nan
    near, touching, nearest = measured(backend, before, after, 0.5, collision, bound)
    assert (near, touching, nearest) == measured(reference, before, after, 0.5, collision, bound)
    with np.errstate(invalid="ignore"):
        assert near == np.triu(distances(after) <= 0.25, 1).sum()
        found, apart = np.zeros((uavs, uavs), dtype=bool), closest_approaches(before, after)
        found[tuple(np.array(touching, dtype=np.intp).reshape(-1, 2).T)] = True
        assert touching == sorted(touching)
        assert (found >= np.triu(apart < collision - 1e-12, 1)).all()
        assert (found <= np.triu(apart < collision + 1e-12, 1)).all()
    least = np.fmin.reduce(apart[np.triu_indices(uavs, 1)], initial=bound)
    assert nearest == pytest.approx(float(least), rel=1e-9, abs=1e-12)


@pytest.mark.xdist_group("sweep")
@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize(
    ("spread", "step", "longest", "bound"),
    [
        (60.0, 0.1, 0.0, math.inf),
        (60.0, 0.1, 0.0, 0.01),
        (60.0, 0.1, 3.0, math.inf),
        (60.0, 1e-9, 12.0, 0.01),
        (8.0, 0.02, 0.0, math.inf),
        (1e6, 0.1, 0.0, math.inf),
        (1e6, 0.1, 9.0, math.inf),
        (0.2, 0.0, 0.0, math.inf),
    ],
)
def test_a_sweep_by_strips_finds_what_a_comparison_of_all_pairs_does(
    backend: ModuleType, axes: int, spread: float, step: float, longest: float, bound: float
) -> None:
    """Dense and scattered; segments of all lengths, and one across everything; some UAVs have the same place."""
    before, after, nears, expected, least = _dense_or_scattered(axes, spread, step, longest)
    found = np.empty((10**6 if spread > 1.0 else 0, 2), dtype=np.intp)
    near, count, nearest = backend.pairs(before, after, 0.5, 0.1, bound, found)
    assert (near, count, nearest) == (nears, len(expected), math.sqrt(min(bound * bound, least)))
    np.testing.assert_array_equal(found[:count], expected[: len(found)])


@cache
def _dense_or_scattered(axes: int, spread: float, step: float, longest: float) -> tuple:
    """States before and after a tick; and what a comparison of all pairs finds: near pairs, pairs that touch, and the
    least squared distance. It takes seconds, and is the same for both forms and all bounds."""
    draw = np.random.default_rng(4)
    before = np.zeros((MANY + 100, 2 * axes))
    before[:, :axes] = draw.normal(size=(len(before), axes)) * spread
    before[100:150] = before[:50]
    lengths = step * 10.0 ** draw.uniform(0.0, longest, size=(len(before), 1))
    after = before + draw.normal(size=before.shape) * lengths
    after[7, :axes] += 0.5 * spread
    before[11], after[13] = np.nan, np.nan
    by_axis = [np.asfortranarray(state.position(states)) for states in (before, after)]  # a third faster
    compared = [_compared(*by_axis, uav, 0.5, 0.1) for uav in range(len(before))]
    nears, touching, distances = zip(*compared, strict=True)
    return before, after, sum(nears), np.concatenate(touching), min(distances)


def _compared(before: np.ndarray, after: np.ndarray, one: int, hazard: float, collision: float) -> tuple:
    """The near pairs, the pairs that touch, and the least squared distance, of a UAV with all later ones."""
    start, end = (places[one + 1 :] - places[one] for places in (before, after))
    with np.errstate(invalid="ignore"):
        approach = state.approach(start, end)
        touch = one + 1 + np.flatnonzero(approach < collision * collision)
        near = np.count_nonzero(state.dot(end, end) <= hazard * hazard)
    return near, np.stack([np.full_like(touch, one), touch], axis=-1), float(np.fmin.reduce(approach, initial=math.inf))


def test_a_uav_without_a_finite_position_has_no_neighbours(backend: ModuleType) -> None:
    states = np.zeros((4, 4))
    states[0], states[1, 0], states[2, 1] = np.nan, np.inf, 1e200
    with np.errstate(all="ignore"):
        assert measured(backend, states, states, 1.0, 1.0, math.inf) == (0, [], math.inf)


def test_pairs_beyond_the_room_for_them_are_counted(backend: ModuleType) -> None:
    found = np.full((3, 2), -7)
    states = np.zeros((6, 4))
    for room in (found[:2], found[:0]):
        assert backend.pairs(states, states, 1.0, 1.0, math.inf, room) == (15, 15, 0.0)
        assert (found[:2] >= 0).all()
        assert found[2].tolist() == [-7, -7]


def test_a_large_swarm_needs_no_room_for_all_its_pairs(backend: ModuleType) -> None:
    states = np.random.default_rng(6).normal(size=(2000, 4)) * [100.0, 100.0, 1.0, 1.0]
    tracemalloc.start()
    try:
        backend.alignment(states)
        backend.pairs(states, states + 0.1, 0.7, 0.1, math.inf, np.empty((64, 2), dtype=np.intp))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * 2**20 < 8 * 2000**2


# -- the mean difference of velocities -------------------------------------------------------------------------------


def exact(velocities: np.ndarray) -> float:
    total = 0.0
    for i, velocity in enumerate(velocities):
        apart = velocities[i + 1 :] - velocity
        total += float(state.length(apart).sum())
    return 2.0 * total / len(velocities) ** 2


def flown(velocities: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(velocities.shape), velocities], axis=-1)


@both_forms
@given(st.integers(1, FEW), st.sampled_from([2, 3]), st.integers(0, 2**32 - 1))
def test_few_uavs_are_one_sum_in_double_precision(backend: ModuleType, uavs: int, axes: int, seed: int) -> None:
    velocities = np.random.default_rng(seed).choice([0.0, 0.1, -0.3, 1.0, 1e-160, 1e6 + 0.25], (uavs, axes))
    speeds = state.length(velocities[:, None] - velocities)
    assert backend.alignment(flown(velocities)) == speeds.ravel().sum() / uavs**2


@st.composite
def velocities_of_many(draw: st.DrawFn) -> np.ndarray:
    """Velocities of more than FEW UAVs, of two or three axes: clusters of any widths, on a line or not, some UAVs far
    away, some alike.
    """
    axes = draw(st.sampled_from([2, 3]))
    uavs = draw(st.sampled_from([FEW + 1, 800, 1500]))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    clusters = draw(st.integers(1, 5))
    widths = np.array(
        draw(st.lists(st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 1.0]), min_size=clusters, max_size=clusters))
    )
    cluster = random.integers(clusters, size=uavs)
    velocities = random.normal(size=(clusters, axes))[cluster]
    velocities += widths[cluster, None] * random.normal(size=(uavs, axes))
    far = random.integers(uavs, size=draw(st.sampled_from([0, 1, 7, uavs // 4])))
    velocities[far] *= draw(st.sampled_from([30.0, 1e4, 1e9]))
    velocities[:, 1] *= draw(st.sampled_from([0.0, 1e-6, 1.0]))
    if draw(st.booleans()):
        velocities = np.round(velocities, 1)  # many alike
    angle = draw(st.sampled_from([0.0, 0.7]))
    turn = np.eye(axes)
    turn[:2, :2] = [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]
    return velocities @ turn * draw(st.sampled_from([1e-9, 1.0, 1e6])) + draw(st.sampled_from([0.0, 12.0]))


@settings(both_forms, max_examples=60)
@given(velocities_of_many())
def test_the_error_is_bounded_and_both_forms_alike_for_any_velocities(
    backend: ModuleType, velocities: np.ndarray
) -> None:
    """Of velocities far from zero, the differences themselves are known to 2⁻⁵² of the velocities only."""
    found, rounding = backend.alignment(flown(velocities)), 2.0**-50 * float(np.abs(velocities).max())
    assert found == pytest.approx(exact(velocities), rel=ALIGNMENT_ERROR, abs=rounding)
    assert found == reference.alignment(flown(velocities))


@pytest.mark.parametrize("uavs", [0, 1, FEW + 1, 1500])
def test_equal_velocities_have_no_difference(backend: ModuleType, uavs: int) -> None:
    assert backend.alignment(flown(np.full((uavs, 2), 0.5))) == 0.0


@pytest.mark.parametrize("uavs", [2, FEW + 1, 1500])
@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e200])
def test_a_velocity_beyond_all_bounds_gives_no_finite_number(backend: ModuleType, uavs: int, bad: float) -> None:
    velocities = np.random.default_rng(1).normal(size=(uavs, 2))
    velocities[1, 0] = bad
    with np.errstate(all="ignore"):
        assert not math.isfinite(backend.alignment(flown(velocities)))
