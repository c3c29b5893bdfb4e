"""FedAvg is a mean, and the order in which models arrived leaves no trace in it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.federation.rules.fedavg import mean


def fedavg(models: dict[int, np.ndarray]) -> np.ndarray:
    """The mean of models that arrived, by UAV."""
    return mean(np.stack([models[uav] for uav in sorted(models)]).astype(np.float64))


def models(count: int, seed: int = 1) -> dict[int, np.ndarray]:
    """Models whose sum depends on its order: magnitudes from 1e-8 to 1e8."""
    draw = np.random.default_rng(seed)
    return {
        uav: draw.standard_normal(246) * 10.0 ** draw.integers(-8, 9, 246) for uav in draw.permutation(count).tolist()
    }


@settings(max_examples=60, deadline=None, database=None)
@given(st.permutations(range(20)))
def test_the_order_of_arrival_leaves_no_trace(order: list[int]) -> None:
    arrived = models(20)
    assert fedavg({uav: arrived[uav] for uav in order}).tobytes() == fedavg(arrived).tobytes()


def test_the_order_would_leave_a_trace_if_it_could() -> None:
    arrived = list(models(20).values())
    assert sum(arrived).tobytes() != sum(arrived[::-1]).tobytes()  # type: ignore[union-attr]


def test_it_is_the_mean_of_what_arrived_to_the_last_digits() -> None:
    arrived = models(7)
    exact = np.mean(np.array(list(arrived.values()), dtype=np.longdouble), axis=0)
    scale = np.abs(np.array(list(arrived.values()))).max(axis=0)
    assert (np.abs(fedavg(arrived) - exact) <= 1e-15 * scale).all()


def test_equal_models_are_their_own_mean_and_one_model_is_itself() -> None:
    one = models(1)[0]
    np.testing.assert_array_equal(fedavg({3: one}), one)
    np.testing.assert_array_equal(fedavg({3: one, 9: one, 1: one, 0: one}), one)


def test_no_argument_is_changed_and_single_precision_is_summed_in_double() -> None:
    arrived = {uav: vector.astype(np.float32) for uav, vector in models(5).items()}
    before = {uav: vector.copy() for uav, vector in arrived.items()}
    average = fedavg(arrived)
    assert average.dtype == np.float64
    for uav, vector in arrived.items():
        np.testing.assert_array_equal(vector, before[uav])


def test_nothing_has_no_mean() -> None:
    with pytest.raises(ValueError, match="at least one"):
        fedavg({})
