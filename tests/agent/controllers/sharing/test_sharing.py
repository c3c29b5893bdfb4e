"""The common part of all controllers that share states: which states they use, and how they fly by them."""

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Received
from tests.agent.controllers.by_hand import made, stepped

METHODS = ("vasarhelyi", "olfati-saber", "potential-field", "orca", "bvc")
STATES = np.array([[70.0, 0.0, 0, 0], [71.0, 0.0, 0, 0], [70.0, 30.0, 0, 0]])
each = pytest.mark.parametrize("method", METHODS)


@each
def test_a_received_state_moves_its_receiver_and_a_false_one_is_named_and_moves_no_uav(method: str) -> None:
    controller = made(method, "sharing.policy=tick", uavs=3)
    memory = controller.init(np.arange(3), STATES)
    said = [[70.3, 0.4, 0, 0], [70.3, 0.4, 300, 0]]
    true, false = (Received(0, np.array([2]), np.array([state]), np.array([[0, 0]])) for state in said)
    alone, pushed, fooled = (controller.step(memory, 1, STATES, received) for received in ([], [true], [false]))
    assert np.hypot(*(pushed.acceleration - alone.acceleration)[0]) > 0.01
    assert pushed.acceleration[1:].tobytes() == alone.acceleration[1:].tobytes()
    assert not len(pushed.refused)
    assert fooled.acceleration.tobytes() == alone.acceleration.tobytes()
    assert fooled.refused.tolist() == [2]


@each
def test_a_state_beyond_16_bits_is_not_sent_and_counted(method: str) -> None:
    controller = made(method, uavs=3)
    memory = controller.init(np.arange(3), STATES)
    step = controller.step(memory, 1, STATES + np.array([[0, 0, 0, 0], [900.0, 0, 0, 0], [1.0, 0, 0, 0]]), ())
    assert step.diagnostics is not None
    assert step.diagnostics[:, -1].tolist() == [0.0, 1.0, 0.0]
    assert step.broadcasts[0].rows.tolist() == [2]  # type: ignore[union-attr]


@each
def test_two_uavs_in_one_place_come_apart(method: str) -> None:
    step = stepped(made(method), np.array([[70.0, 0.0, 0, 0], [70.0, 0.0, 0, 0]]))
    assert np.isfinite(step.acceleration).all()
    if method != "olfati-saber":  # whose force vanishes there
        assert step.acceleration[0, 0] < step.acceleration[1, 0] - 1.0


@pytest.mark.parametrize(("method", "mean_s"), [("vasarhelyi", 82.0), ("olfati-saber", 110.0), ("orca", 82.0)])
def test_the_swarm_arrives_without_a_collision_and_events_take_a_tenth_of_the_bits(method: str, mean_s: float) -> None:
    runs = [
        mf.fly("paper", method=method, seed=4, **{"sharing.policy": policy}).summary for policy in ("tick", "event")
    ]
    for summary in runs:
        assert (summary["collisions_all"], summary["arrived"]) == (0, 25)
        assert summary["t_avg_s"] < mean_s
    every_tick, events = (summary["payload_bits"]["state"] for summary in runs)
    assert events < 0.1 * every_tick


@pytest.mark.parametrize(("method", "hits"), [*((method, 0) for method in METHODS), ("cruise", 2)])
def test_a_uav_alone_arrives_round_discs_that_lie_in_its_way(method: str, hits: int) -> None:
    discs = [{"centre": [75.0, 50.3], "radius": 3.0}, {"centre": [40.0, 26.0], "radius": 2.0}]
    summary = mf.fly("paper", method=method, uavs=1, seed=1, obstacles=discs, duration=120).summary
    assert (summary["obstacle_hits"], summary["arrived"]) == (hits, 1)
    assert summary["radio"]["traffic"]["state"]["sent"] == 0
