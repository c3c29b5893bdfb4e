"""rls in flight: it identifies drag and wind that it was not told, as least squares over all that was seen do."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.settings import scenario_of
from meanflock.swarm import mission, plugins

NAMES = ("drag", "push_x", "push_y")


def flown(mission_name: str, **options: Any) -> mf.Run:
    settings = {f"controller.{name}": value for name, value in ({"noise": 0.5} | options).items()}
    return mf.fly(mission_name, method="rls", seed=1, duration=40, **settings)


def reported(run: mf.Run, name: str) -> np.ndarray:
    """(T, N)"""
    return np.array(run.frame().column(name).to_pylist(), dtype=np.float64)


def truth(run: mf.Run) -> np.ndarray:
    """(3,): the drag that flies, and its product with the wind."""
    wind = run.scenario.flown().wind
    return np.array([wind.drag, *(wind.drag * np.array(wind.mean))])


@pytest.fixture(scope="module")
def shared() -> mf.Run:
    return flown("unknown")


def test_averaged_estimates_are_what_nobody_was_told(shared: mf.Run) -> None:
    told = shared.scenario.wind.drag * np.array([1.0, *shared.scenario.wind.mean])
    found = np.array([reported(shared, name)[200].mean() for name in NAMES])
    assert found == pytest.approx(truth(shared), abs=0.1)  # towards the prior, zero, in what the path shows least
    assert np.abs(truth(shared) - told).max() > 0.3


def test_alone_they_are_farther_from_it(shared: mf.Run) -> None:
    alone = flown("unknown", share=False)
    assert alone.summary["payload_bits"]["uplink"] == 0
    off = [
        np.sqrt(np.mean([(reported(run, name)[200] - true) ** 2 for name, true in zip(NAMES, truth(run), strict=True)]))
        for run in (shared, alone)
    ]
    assert off[0] < 0.7 * off[1]


def test_it_is_least_squares_with_a_prior() -> None:
    """The recursion over a flight by hand, beside the normal equations of all its ticks at once."""
    controller: Any = plugins.create("controller", "rls", {"share": False}, mf.Scenario())
    plan = mission.starts(controller.scenario)
    memory, states, dt = controller.init(np.arange(25), plan), plan, controller.scenario.dt
    rng, (prior, noise) = np.random.default_rng(3), (controller.options.prior, controller.options.noise)
    squares, products = np.tile(np.eye(3) * (noise / prior) ** 2, (25, 1, 1)), np.zeros((25, 3))
    for tick in range(40):
        step = controller.step(memory, tick, states, ())
        memory, velocity = step.memory, states[:, 2:] + dt * (step.acceleration + rng.normal(size=(25, 2)))
        if tick < 39:  # what the last one does is not seen any more
            for axis in range(2):
                features = np.zeros((25, 3))
                features[:, 0], features[:, 1 + axis] = -states[:, 2 + axis], 1.0
                beyond = (velocity[:, axis] - states[:, 2 + axis]) / dt - step.acceleration[:, axis]
                squares += features[:, :, None] * features[:, None, :]
                products += features * beyond[:, None]
        states = np.concatenate([states[:, :2] + dt * velocity, velocity], axis=1)
    expected = np.linalg.solve(squares, products[..., None])[..., 0]
    assert memory["estimate"] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_a_pause_and_the_ground_teach_nothing() -> None:
    start = {"start.formation": "waves", "start.interval": 10.0, "start.group": 5}
    controller: Any = plugins.create("controller", "rls", {}, scenario_of("paper", start, uavs=10))
    plan = mission.starts(controller.scenario)
    memory = controller.init(np.arange(10), plan)
    for tick in (0, 1, 5):
        memory = controller.step(memory, tick, plan, ()).memory
    seen = memory["covariance"][:, 1, 1] < memory["covariance"][9, 1, 1]
    assert seen.tolist() == [True] * 5 + [False] * 5
    again = controller.step(memory, 9, plan, ()).memory
    assert again["estimate"].tobytes() == memory["estimate"].tobytes()


@pytest.mark.parametrize("forgetting", [0.5, 0.9])
def test_what_is_forgotten_where_nothing_new_is_seen_does_not_grow_for_ever(forgetting: float) -> None:
    """At rest the drag cannot be seen; the least that is known of it is what was known before take-off."""
    run = mf.fly(
        "paper", method="rls", seed=1, uavs=2, duration=300, stop="duration", **{"controller.forgetting": forgetting}
    )
    assert run.summary["lost"] == 0
    assert run.summary["arrived"] == 2
    assert np.abs([reported(run, name)[-1] for name in NAMES]).max() < 10.0
