"""Keeping apart in flight: what it does, what it costs the radio, and what it leaves alone."""

import numpy as np
import pytest

from meanflock.agent.controllers.mean_field.methods import MfgflHf, Separation
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load

NONE = np.zeros(0, dtype=np.intp)
SLOW = ("learner.velocity_scale=80", "learner.kappa=0.04")


def flown(*settings: str, method: str = "mfgfl-hf", **options: int) -> dict[str, object]:
    summary = Engine(load(None, settings, method=method, **options), "separation").complete()
    return dict(summary)


def test_a_swarm_that_would_touch_rarely_does() -> None:
    """Under the paper's cost pairs collide on the way, like a gas; with the repulsion few do."""
    without, apart = (
        [flown(*more, seed=seed)["collisions"] for seed in (1, 2)] for more in ((), ("cost.separation=5",))
    )
    assert sum(apart) < sum(without) / 3  # type: ignore[arg-type]


def test_states_are_paid_for_only_where_they_are_shared() -> None:
    bits = [
        flown("duration=10", *more)["payload_bits"]["state"]  # type: ignore[index]
        for more in ((), ("cost.separation=5",))
    ]
    assert bits == [25 * 4 * 32, 100 * 25 * 4 * 32]  # before take-off; and then in each tick but the first
    hjb = [flown("duration=10", *more, method="hjb")["payload_bits"] for more in ((), ("cost.separation=5",))]
    assert hjb[0] == hjb[1]  # what it shares already is enough


def test_where_nobody_is_near_it_changes_nothing() -> None:
    spread = ("duration=8", "start.spacing=30", "wind.sigma=0")
    states = [flown(*spread, *more)["trajectory_sha256"] for more in ((), ("cost.separation=5",))]
    assert states[0] == states[1]


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


def test_a_key_that_came_later_leaves_older_hashes() -> None:
    plain = Scenario().sha256()
    assert load(None, ["cost.separation=0", "learner.multinomial=false"]).sha256() == plain
    for settings in (
        ["cost.separation=1"],
        ["cost.separation_range=1", "cost.separation=0"],
        ["learner.multinomial=true"],
    ):
        assert load(None, settings).sha256() != plain


def test_a_lyapunov_function_without_a_cross_term_only_damps() -> None:
    """κ = 0: L_s = ½‖s‖², whose gradient by velocity is v: nothing pulls a UAV at rest, wherever it is."""
    flight = flown("learner.kappa=0", "cost.c2=0", "wind.sigma=0", "wind.mean=[0,0]", "duration=5", method="mfg")
    assert flight["distance_mean_m"] == pytest.approx(0.0, abs=1e-9)


def test_who_is_not_heard_for_a_second_is_no_longer_avoided() -> None:
    """A UAV far away is out of the radio's range; where it took off, nobody is."""
    scenario = load(None, ["uavs=2", "cost.separation=5"], method="mfgfl-hf")
    of, plan = Separation(scenario), np.array([[0.0, 0.0, 0.0, 0.0], [0.3, 0.0, 0.0, 0.0]])
    memory, pushes = of.init(np.array([0]), plan), []
    for tick in range(13):
        memory, pushed = of.step(memory, tick, plan[:1], memory["believed"], (NONE, NONE))
        pushes.append(bool(pushed.any()))
    assert pushes == [True] * 11 + [False] * 2
    heard = np.array([0]), np.array([1])  # and it still is where it was
    assert of.step(memory, 13, plan[:1], memory["believed"], heard)[1][0, 0] < 0
