"""The built-in means: the plain mean of FedAvg, and the mean weighted by precisions."""

import numpy as np
import pytest

from meanflock.federation.rules.base import Uploads
from meanflock.federation.rules.fedavg import mean
from meanflock.federation.rules.precision import Precision
from meanflock.swarm.scenario import Scenario


def models(count: int) -> np.ndarray:
    """Models whose sum depends on its order: magnitudes from 1e-8 to 1e8."""
    draw = np.random.default_rng(1)
    return np.asarray(draw.standard_normal((count, 246)) * 10.0 ** draw.integers(-8, 9, (count, 246)))


def test_fedavg_is_the_mean_to_the_last_digits() -> None:
    arrived = models(7)
    exact = np.mean(arrived.astype(np.longdouble), axis=0)
    assert (np.abs(mean(arrived) - exact) <= 1e-15 * np.abs(arrived).max(axis=0)).all()
    assert mean(arrived.astype(np.float32)).dtype == np.float64


def weighted(table: list[list[float]], means: int) -> list[float]:
    """The model that averaging by precision makes of some models."""
    rule = Precision(Precision.Options(means=means), Scenario())
    _, model = rule.step({}, Uploads.complete(np.array(table)))
    return [float(number) for number in model]


def test_means_are_weighted_by_their_precisions() -> None:
    table = [  # x of two quantities, y of them, precisions
        [1.0, 5.0, 10.0, 7.0, 1.0, 0.0],
        [4.0, 6.0, 40.0, 8.0, 3.0, 0.0],
        [9.0, 7.0, 90.0, 9.0, 0.0, 0.0],
    ]
    assert weighted(table, 2) == [13 / 4, 6.0, 130 / 4, 8.0, 4 / 3, 0.0]
    assert weighted([[1.0, 2.0], [100.0, -5.0]], 1) == [1.0, 1.0]  # a precision below zero does not count


def test_precision_refuses_a_model_that_its_options_do_not_divide() -> None:
    with pytest.raises(ValueError, match="10 numbers is no 3 vectors"):
        Precision(Precision.Options(means=2), Scenario()).init(10)
