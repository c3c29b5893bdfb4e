"""Averaging by precision: worked by hand, and what a round is to those who know nothing."""

import numpy as np
import pytest

from meanflock.federation.rules.precision import Precision
from meanflock.swarm.scenario import Scenario

UAVS = np.arange(3)


def rule(means: int = 2) -> Precision:
    return Precision(Precision.Options(means=means), Scenario())


def test_a_case_by_hand() -> None:
    models = np.array(
        [  # x of two quantities, y of them, precisions
            [1.0, 5.0, 10.0, 7.0, 1.0, 0.0],
            [4.0, 6.0, 40.0, 8.0, 3.0, 0.0],
            [9.0, 7.0, 90.0, 9.0, 0.0, 0.0],
        ]
    )
    _, model = rule().step({}, models, UAVS, 1)
    assert model.tolist() == [13 / 4, 6.0, 130 / 4, 8.0, 4 / 3, 0.0]


def test_what_all_agree_on_stays_however_many_rounds() -> None:
    models = np.tile([2.0, 3.0, 0.5], (3, 1))
    model = models[0]
    for number in range(1, 6):
        _, model = rule().step({}, np.tile(model, (3, 1)), UAVS, number)
    assert model == pytest.approx(models[0])


def test_a_precision_below_zero_does_not_count() -> None:
    models = np.array([[1.0, 2.0], [100.0, -5.0]])
    _, model = rule(1).step({}, models, np.arange(2), 1)
    assert model.tolist() == [1.0, 1.0]


def test_a_model_of_another_form_is_refused_before_it_flies() -> None:
    with pytest.raises(ValueError, match="10 numbers is no 3 vectors"):
        rule().init(10)
