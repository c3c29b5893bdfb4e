"""The plug-ins that meanflock leaves out compute what their sources say."""

import math
from typing import Any

import numpy as np
import pytest
from meanflock.launch.engine import Engine

import meanflock as mf
from research import left_out

FOUR = mf.Scenario(uavs=4)


def test_the_last_upload_of_a_uav_counts_until_it_sends_another() -> None:
    rule = left_out.LastUpload(left_out.LastUpload.Options(), FOUR)
    state, model = rule.step(rule.init(1), mf.Uploads.complete(np.array([[1.0], [3.0]]), 1, np.array([0, 2])))
    assert model.tolist() == [2.0]
    state, model = rule.step(state, mf.Uploads.complete(np.array([[5.0]]), 2, np.array([2])))
    assert model.tolist() == [3.0]


def test_the_noise_of_privacy_is_that_of_the_best_order_of_its_divergence() -> None:
    rule = left_out.Private(left_out.Private.Options(epsilon=9.0), mf.Scenario(method="fed-lspi"))
    rounds, orders = 300.0 / 2.0, np.linspace(1.001, 50.0, 100_000)
    epsilon = orders * rounds / (2.0 * rule.noise() ** 2) + math.log(1.0 / left_out.DELTA) / (orders - 1.0)
    assert epsilon.min() == pytest.approx(9.0, rel=1e-6)


def test_no_upload_moves_a_private_model_by_more_than_its_share() -> None:
    """The noise of a round is the same whatever was uploaded."""
    rule = left_out.Private(left_out.Private.Options(epsilon=9.0, start=(0.0, 0.0)), mf.Scenario(method="fed-lspi"))
    near, far = (mf.Uploads.complete(np.array([[0.0, 0.0], [0.0, value]])) for value in (0.0, 1e6))
    moved = rule.step(rule.init(2), far)[1] - rule.step(rule.init(2), near)[1]
    np.testing.assert_allclose(moved, [0.0, 0.3 / 2], atol=1e-12)


def test_an_older_upload_counts_less() -> None:
    rule = left_out.Aged(left_out.Aged.Options(), FOUR)
    uploads = mf.Uploads.complete(np.array([[0.0], [3.0]]), 5)
    uploads.sent[0] = 2
    assert rule.step({}, uploads)[1].tolist() == [2.0]


def test_the_control_variates_have_the_shared_one_as_their_mean() -> None:
    memories: list[Any] = []

    class Watched(left_out.MfgflHfScaffold):
        name = "watched"

        def step(self, memory: Any, tick: int, own: Any, received: Any) -> Any:
            memories.append(memory)
            return super().step(memory, tick, own, received)

    settings = {"radio.model": "ideal", "radio.bits_per_float": 64, "federation.fraction": 1.0, "federation.period": 20}
    Engine(mf.Scenario(method=Watched, uavs=5, stop="duration", duration=8.0, **settings), "flight").complete()
    shared = memories[75]["shared"]
    assert np.abs(shared).max() > 1e-4
    np.testing.assert_allclose(memories[75]["own"].mean(axis=0), shared[0], atol=1e-15)


def test_the_mean_of_mixed_drags_is_that_of_the_scenario() -> None:
    vehicle = left_out.MixedDrag(left_out.MixedDrag.Options(), FOUR)
    plain = left_out.PointMass(left_out.PointMass.Options(), FOUR)
    states, still = np.tile([0.0, 0.0, 3.0, 0.0], (4, 1)), np.zeros((4, 2))
    (mixed, _), (alike, _) = (each.step(states, {}, still, still) for each in (vehicle, plain))
    slowed = 3.0 - mixed[:, 2]
    assert (np.diff(slowed) > 0.0).all()
    assert slowed.mean() == pytest.approx(3.0 - alike[0, 2])
