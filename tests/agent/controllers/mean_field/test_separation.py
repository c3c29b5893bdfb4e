"""The repulsion of `cost.separation` in flight: its effect, and its cost by radio."""

from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.mean_field.methods import MfgflHf, Separation
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load

NONE = np.zeros(0, dtype=np.intp)


def flown(*settings: str, method: str = "mfgfl-hf") -> dict[str, Any]:
    return Engine(load(None, settings, method=method), "separation").complete()


def test_a_swarm_that_would_touch_rarely_does() -> None:
    without, apart = (flown("duration=60", *more)["collisions"] for more in ((), ("cost.separation=5",)))
    assert apart < without / 3


def test_states_are_paid_for_only_where_they_are_shared() -> None:
    bits = [flown("duration=10", *more)["payload_bits"]["state"] for more in ((), ("cost.separation=5",))]
    assert bits == [25 * 4 * 32, 100 * 25 * 4 * 32]  # before take-off; and then in each tick but the first
    hjb = [flown("duration=10", *more, method="hjb")["payload_bits"] for more in ((), ("cost.separation=5",))]
    assert hjb[0] == hjb[1]  # what it shares already is enough


def test_believed_states_fly_on_while_nothing_is_heard() -> None:
    scenario = load(None, ["uavs=2", "cost.separation=5", "start.spacing=100"], method="mfgfl-hf")
    controller = MfgflHf(MfgflHf.Options(), scenario)
    plan = np.array([[0.0, 0.0, 1.0, 0.0], [0.3, 0.0, 0.0, 2.0]])
    memory = controller.init(np.array([0]), plan)
    for tick in range(3):
        step = controller.step(memory, tick, plan[:1], ())
        memory = step.memory
        assert len(step.broadcasts) == (tick > 0)
    np.testing.assert_allclose(memory["believed"][0, 1], [0.3, 0.4, 0.0, 2.0])  # two ticks of 0.1 s at 2 m/s
    np.testing.assert_array_equal(memory["believed"][0, 0], plan[0])


def test_two_ways_of_sharing_states_at_once_are_refused() -> None:
    with pytest.raises(BadInput, match=r"federation\.state_period.*cost\.separation"):
        _ = load(None, ["federation.state_period=5", "cost.separation=1"], method="mfg").declared


def test_a_uav_that_is_not_heard_for_a_second_is_no_longer_avoided() -> None:
    """A UAV far away is out of the radio's range; where it took off, nobody is."""
    scenario = load(None, ["uavs=2", "cost.separation=5"], method="mfgfl-hf")
    separation, plan = Separation(scenario), np.array([[0.0, 0.0, 0.0, 0.0], [0.3, 0.0, 0.0, 0.0]])
    memory, pushes = separation.init(np.array([0]), plan), []
    for tick in range(13):
        memory, pushed = separation.step(memory, tick, plan[:1], memory["believed"], (NONE, NONE))
        pushes.append(bool(pushed.any()))
    assert pushes == [True] * 11 + [False] * 2
    heard = np.array([0]), np.array([1])  # and it still is where it was
    assert separation.step(memory, 13, plan[:1], memory["believed"], heard)[1][0, 0] < 0
