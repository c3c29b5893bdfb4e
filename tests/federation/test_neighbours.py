"""Averaging without a leader: what one exchange computes, what a radio does to it, and who is silent."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.exchange import Exchange
from meanflock.federation.rules.base import mean
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.federation.plugins import Momentum
from tests.telemetry import fly

DOUBLES = ("radio.bits_per_float=64", "federation.topology=neighbours")


def scenario(uavs: int, *settings: str, method: str = "mfgfl-h") -> Scenario:
    fixed = [f"uavs={uavs}", "federation.topology=neighbours", "federation.period=20", "duration=35"]
    return load(None, [*fixed, 'stop="duration"', *settings], method=method, seed=5)


def exchanged(of: Scenario, models: np.ndarray, links: np.ndarray, uavs: Any = None, number: int = 1) -> np.ndarray:
    """The models (M, L) of `uavs` after one round in which models (N, L) went over `links` (K, 2): UAV to UAV."""
    uavs = np.arange(of.uavs) if uavs is None else np.array(uavs)
    exchange = Exchange(of.hops[-1], of, uavs, [])
    exchange.remember(number, np.arange(len(uavs)), models[uavs])
    here = links[np.isin(links[:, 1], uavs)].astype(np.int32)
    for batch in np.array_split(here, 3):  # as if they had arrived in three ticks
        if len(batch):
            source, row = np.unique(batch[:, 0], return_inverse=True)
            ends = np.stack([row, batch[:, 1]], axis=-1).astype(np.int32)
            exchange.collect(Frames(FrameKind.UPLOAD, number, source.astype(np.int32), models[source], ends))
    rows, averages, refused = exchange.average(number, np.ones(len(uavs), dtype=bool))
    assert refused == []
    after = models[uavs].copy()
    after[rows] = averages
    return after


def drawn(of: Scenario, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(of.uavs, of.declared.parameters))


def pairs(adjacency: np.ndarray) -> np.ndarray:
    return np.argwhere(adjacency & ~np.eye(len(adjacency), dtype=bool))


def ring(uavs: int) -> np.ndarray:
    apart = np.abs(np.subtract.outer(np.arange(uavs), np.arange(uavs)))
    return np.minimum(apart, uavs - apart) <= 1


def grid(side: int) -> np.ndarray:
    x, y = np.divmod(np.arange(side * side), side)
    return np.abs(np.subtract.outer(x, x)) + np.abs(np.subtract.outer(y, y)) <= 1


@pytest.mark.parametrize("adjacency", [ring(9), grid(3)], ids=["ring", "grid"])
def test_the_spread_contracts_as_the_mixing_matrix_says(adjacency: np.ndarray) -> None:
    of = scenario(9, *DOUBLES)
    mixing = adjacency / adjacency.sum(axis=1, keepdims=True)
    second = np.sort(np.abs(np.linalg.eigvals(mixing)))[-2]
    models, spreads = drawn(of), []
    for number in range(1, 31):
        expected = mixing @ models
        models = exchanged(of, models, pairs(adjacency), number=number)
        np.testing.assert_allclose(models, expected, atol=1e-12)
        spreads.append(np.ptp(models, axis=0).max())
    measured = (spreads[-1] / spreads[9]) ** (1 / 20)
    assert measured == pytest.approx(second, rel=0.05)


def test_a_rule_that_is_not_linear_gets_what_was_received_and_the_own_model() -> None:
    of = scenario(5, *DOUBLES, "federation.aggregation=median")
    models = drawn(of)
    after = exchanged(of, models, np.array([[0, 3], [1, 3], [4, 3]]))
    np.testing.assert_array_equal(after[3], np.median(models[[0, 1, 3, 4]], axis=0))
    np.testing.assert_array_equal(after[[0, 1, 2, 4]], models[[0, 1, 2, 4]])  # they heard nobody


def test_models_that_cannot_be_averaged_are_refused_and_the_others_count() -> None:
    of = scenario(4, *DOUBLES)
    models = drawn(of)
    exchange = Exchange(of.hops[-1], of, np.arange(2), [])
    exchange.remember(1, np.arange(2), models[:2])
    sent = models[2:].copy()
    sent[1] = 1e30
    links = np.array([[0, 0], [1, 0], [1, 1]], dtype=np.int32)
    exchange.collect(Frames(FrameKind.UPLOAD, 1, np.array([2, 3], dtype=np.int32), sent, links))
    rows, averages, refused = exchange.average(1, np.ones(2, dtype=bool))
    assert (rows.tolist(), refused) == ([0], [3])
    np.testing.assert_allclose(averages[0], mean(models[[0, 2]]))


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        (lambda uploads: np.zeros(len(uploads.models)), "`weights` has 0.0; each must be greater than 0"),
        (lambda uploads: np.ones(1 + len(uploads.models)), "expected"),
        (lambda uploads: uploads.models[:, 0] * np.nan, "not finite"),
    ],
)
def test_weights_that_are_none_cost_the_round(weights: Any, expected: str) -> None:
    wrong = type("Wrong", (Momentum,), {"name": "wrong", "weights": lambda _self, uploads: weights(uploads)})
    mf.register(wrong)
    summary, sink = fly(scenario(4, "federation.aggregation=wrong", "duration=5"))
    assert summary["lost"] == 0
    assert all(
        "aggregator 'wrong' failed in round" in text and expected in text for text in sink.texts if "wrong" in text
    )
    assert any("wrong" in text for text in sink.texts)


def test_no_leader_flies_and_its_uav_may_die() -> None:
    engine = Engine(scenario(6, "faults=[{kind='kill', tick=50, uavs=[0]}]"), "neighbours", uavs_per_node=2)
    assert all(member.role == "agent" for member in engine.world.members.present)
    summary = engine.complete()
    assert (summary["rounds"], summary["rounds_void"], summary["lost"]) == (17, 0, 1)


def test_uavs_out_of_range_are_isolated_keep_their_models_and_are_counted() -> None:
    lonely = Engine(scenario(4, "start.spacing=20", "federation.range_m=5", "duration=10"), "neighbours").complete()
    assert (lonely["rounds"], lonely["rounds_void"], lonely["rounds_isolated"]) == (0, 4, 16)
    assert lonely["radio"]["traffic"]["uplink"]["sent"] == 0
    near = Engine(scenario(4, "radio.target_snr_db=60", "duration=10"), "neighbours").complete()
    assert (near["rounds"], near["rounds_isolated"]) == (4, 0)
    assert near["weight_spread_final"] < lonely["weight_spread_final"]


def test_a_round_whose_participants_are_all_paused_is_void_and_the_flight_goes_on() -> None:
    paused = scenario(3, "faults=[{kind='pause', tick=15, duration_s=5, uavs=[0, 1, 2]}]", "duration=10")
    summary = Engine(paused, "neighbours").complete()
    assert summary["rounds_void"] >= 2
    assert summary["lost"] == 0


def test_the_first_model_always_goes_and_then_only_one_that_has_moved() -> None:
    """By hand: the norm of the change over that of the model sent last."""
    from meanflock.federation.memory import Trigger

    trigger, rows = Trigger(0.1, 3, 2), np.arange(3)
    assert trigger.due(rows, np.array([[3.0, 4.0], [1.0, 0.0], [0.0, 0.0]])).all()
    moved = np.array([[3.0, 4.6], [1.05, 0.0], [1e-9, 0.0]])
    assert trigger.due(rows, moved).tolist() == [True, False, True]
    assert trigger.due(rows, np.array([[3.0, 4.6], [1.101, 0.0], [1e-9, 0.0]])).tolist() == [False, True, False]
