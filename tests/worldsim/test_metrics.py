"""Metrics of a flock: the oracle's cases, and a flight measured again by hand."""

import json
import math
import tracemalloc
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agent.interaction import empirical
from swarm import state
from swarm.scenario import Metrics, load
from worldsim import metrics
from worldsim.flight import Flight
from worldsim.metrics import FEW, Pairs, few, many, pairs

ORACLE = json.loads((Path(__file__).parents[1] / "oracle" / "metrics.json").read_text())
METRICS = load(None).metrics
RTOL = 1e-9
Measure = Callable[[Metrics, state.States], Pairs]
cases = pytest.mark.parametrize("case", ORACLE, ids=lambda case: f"N{case['N']}")


both_ways = pytest.mark.parametrize("measure", [few, many])


def states_of(case: dict[str, Any]) -> state.States:
    return np.concatenate([case["position"], case["velocity"]], axis=-1)


@cases
@both_ways
def test_alignment_and_risk_are_the_oracle_s(case: dict[str, Any], measure: Measure) -> None:
    n, seen = case["N"], measure(METRICS, states_of(case))
    assert seen.speed_difference.mean() == pytest.approx(case["phi_A_as_printed"], rel=RTOL)
    near = 2 * seen.near.mean()
    assert (near + n) / n**2 == pytest.approx(case["phi_C_as_printed"], rel=RTOL)
    assert near / (n * (n - 1)) == pytest.approx(case["phi_C_distinct_pairs"], rel=RTOL)


@cases
def test_the_empirical_interaction_is_the_oracle_s(case: dict[str, Any]) -> None:
    states = states_of(case)
    known = np.repeat(states[:, None], case["N"], axis=1)  # everyone knows everyone
    found = empirical(states, known, load(None).cost)
    np.testing.assert_allclose(found, case["phi_G_eps1_beta1"], rtol=RTOL)


@cases
@both_ways
def test_many_instants_at_once_are_the_instants_one_by_one(case: dict[str, Any], measure: Measure) -> None:
    wide, states = msgspec.structs.replace(METRICS, collision_radius=1.0), states_of(case)
    together = measure(wide, states)
    assert len(together.colliding)
    for t, instant in enumerate(states):
        alone = measure(wide, instant)
        assert together.speed_difference[t] == alone.speed_difference
        assert together.near[t] == alone.near
        np.testing.assert_array_equal(together.colliding[together.colliding[:, 0] == t, 1:], alone.colliding)


def test_a_flight_s_running_metrics_are_those_of_its_states_measured_by_hand() -> None:
    flown = load(None, ["uavs=5", "start.spacing=0.6", "wind.sigma=0.5", "metrics.hazard_radius=0.8"])
    flight, draw = Flight(flown), np.random.default_rng(2)
    history = [flight.states]
    for _ in range(30):
        flight.advance(draw.standard_normal((5, 2)))
        history.append(flight.states)
    alignment, near = [], 0
    for states in history:
        for i, j in product(range(5), repeat=2):
            alignment.append(math.dist(states[i, state.VELOCITY], states[j, state.VELOCITY]))
            near += math.dist(states[i, state.POSITION], states[j, state.POSITION]) <= 0.8
    assert flight.phi_a == pytest.approx(np.mean(alignment), rel=RTOL)
    assert flight.phi_c == pytest.approx(near / 25 / len(history), rel=RTOL)
    assert flight.phi_c_distinct == pytest.approx((near - 5 * len(history)) / 20 / len(history), rel=RTOL)
    assert 1 / 5 < flight.phi_c < 1


@both_ways
def test_who_flies_alike_has_no_difference_and_colliding_pairs_are_named_once(measure: Measure) -> None:
    states = np.zeros((4, 4))
    states[:, state.VX] = 3.0
    states[:, state.X] = [0.0, 0.05, 5.0, 5.2]
    seen = measure(METRICS, states)
    assert seen.speed_difference == 0.0
    assert seen.near == 2
    assert seen.colliding.tolist() == [[0, 1]]


@pytest.mark.parametrize("shape", [(1,), (2,), (25,), (100,), (3, 25), (2, 1), (2, 3, 7)])
def test_a_small_swarm_s_alignment_is_the_sum_over_the_matrix_of_all_pairs_to_the_last_bit(
    shape: tuple[int, ...],
) -> None:
    states = np.random.default_rng(7).normal(0, 30, (*shape, state.SIZE))
    vx, vy = states[..., state.VX], states[..., state.VY]
    along, across = vx[..., :, None] - vx[..., None, :], vy[..., :, None] - vy[..., None, :]
    matrix = np.sqrt(along * along + across * across)
    total = matrix.reshape(*shape[:-1], shape[-1] ** 2).sum(axis=-1)
    found = few(METRICS, states).speed_difference
    assert np.shape(found) == shape[:-1]
    assert np.asarray(found).tobytes() == np.asarray(total / shape[-1] ** 2).tobytes()


# -- a large swarm's way and a small one's ------------------------------------------------------------------------


def assert_alike(one: Pairs, other: Pairs) -> None:
    np.testing.assert_allclose(one.speed_difference, other.speed_difference, rtol=1e-12, atol=0)
    np.testing.assert_array_equal(one.near, other.near)
    np.testing.assert_array_equal(one.colliding, other.colliding)


@given(
    arrays(  # coarse numbers: coincident UAVs, and pairs exactly on either radius, are common
        np.float64,
        st.tuples(st.integers(1, 3), st.integers(1, 40), st.just(state.SIZE)),
        elements=st.sampled_from([0.0, 0.1, 0.25, -0.3, 0.5, 1.0, -7.75, 1e-160, 1e6, 1e6 + 0.25]),
    ),
    st.sampled_from([1e-3, 0.1, 0.25, 2.0]),
    st.sampled_from([1e-3, 0.25, 0.5, math.sqrt(0.5), 1.0]),
)
def test_both_ways_find_the_same_pairs(states: state.States, collision_radius: float, hazard_radius: float) -> None:
    radii = Metrics(collision_radius=collision_radius, hazard_radius=hazard_radius)
    assert_alike(many(radii, states), few(radii, states))


@pytest.mark.parametrize("spread", [300.0, 3.0, 0.03])  # nobody is near, some are, all are
def test_both_ways_agree_on_a_large_swarm(spread: float) -> None:
    draw = np.random.default_rng(5)
    states = draw.normal(size=(2, 333, state.SIZE)) * [spread, spread, 1.0, 1e-9] + [150.0, 100.0, 12.0, -7.0]
    assert_alike(many(METRICS, states), few(METRICS, states))


def test_the_size_of_the_swarm_decides_which_way_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[tuple[str, int]] = []
    for name in ("few", "many"):
        monkeypatch.setattr(metrics, name, lambda _metrics, states, n=name: taken.append((n, len(states))))
    for uavs in (FEW, FEW + 1):
        pairs(METRICS, np.zeros((uavs, state.SIZE)))
    assert taken == [("few", FEW), ("many", FEW + 1)]


def test_a_large_swarm_s_metrics_need_no_room_for_all_its_pairs() -> None:
    states = np.random.default_rng(6).normal(size=(3000, state.SIZE)) * [100.0, 100.0, 1.0, 1.0]
    many(METRICS, states[:100])  # loads SciPy
    tracemalloc.start()
    try:
        many(METRICS, states)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 8 * 2**20 < 8 * 3000**2
