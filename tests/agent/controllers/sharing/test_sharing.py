"""What all controllers that share states have in common: whom they believe, what they cannot say, and that alone they
fly as if there were nobody."""

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Received
from tests.agent.controllers.by_hand import made, stepped

METHODS = ("vasarhelyi", "olfati-saber", "potential-field")
STATES = np.array([[70.0, 0.0, 0, 0], [71.0, 0.0, 0, 0], [70.0, 30.0, 0, 0]])


@pytest.mark.parametrize("method", METHODS)
def test_a_lie_is_named_and_moves_nobody(method: str) -> None:
    controller = made(method, uavs=3)
    memory = controller.init(np.arange(3), STATES)
    too_fast = np.array([[0, 0, 30_000, 0]], np.int16)
    lie, truth = (Received(0, np.array([2]), payload, np.array([[0, 0]])) for payload in (too_fast, 0 * too_fast))
    honest, fooled = (controller.step(memory, 1, STATES, received) for received in ([], [lie]))
    assert fooled.refused.tolist() == [2]
    assert not len(controller.step(memory, 1, STATES, [truth]).refused)
    assert fooled.acceleration.tobytes() == honest.acceleration.tobytes()


@pytest.mark.parametrize("method", METHODS)
def test_what_was_received_moves_who_received_it(method: str) -> None:
    controller = made(method, "sharing.policy=tick", uavs=3)
    memory = controller.init(np.arange(3), STATES)
    nearby = Received(0, np.array([2]), np.array([[70.3, 0.4, 0, 0]]), np.array([[0, 0]]))
    alone, pushed = (controller.step(memory, 1, STATES, received).acceleration for received in ([], [nearby]))
    assert pushed[0, 1] < alone[0, 1] - 0.1
    assert pushed[1:].tobytes() == alone[1:].tobytes()


@pytest.mark.parametrize("method", METHODS)
def test_a_state_that_cannot_be_said_is_counted(method: str) -> None:
    controller = made(method, uavs=3)
    memory = controller.init(np.arange(3), STATES)
    step = controller.step(memory, 1, STATES + np.array([[0, 0, 0, 0], [900.0, 0, 0, 0], [1.0, 0, 0, 0]]), ())
    assert step.diagnostics is not None
    assert step.diagnostics[:, 0].tolist() == [0.0, 1.0, 0.0]
    assert step.broadcasts[0].rows.tolist() == [2]  # type: ignore[union-attr]


@pytest.mark.parametrize("method", METHODS)
def test_alone_it_arrives(method: str) -> None:
    summary = mf.fly("paper", method=method, uavs=1, seed=5).summary
    assert summary["arrived"] == 1
    assert summary["collisions"] == 0
    assert summary["radio"]["traffic"]["state"]["sent"] == 0


@pytest.mark.parametrize("method", METHODS)
def test_two_in_one_place_come_apart_or_at_least_to_no_harm(method: str) -> None:
    together = np.array([[70.0, 0.0, 0, 0], [70.0, 0.0, 0, 0]])
    step = stepped(made(method), together)
    assert np.isfinite(step.acceleration).all()
    if method != "olfati-saber":  # whose force vanishes there
        assert step.acceleration[0, 0] < step.acceleration[1, 0] - 1.0
