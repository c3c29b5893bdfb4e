"""rls in flight: it identifies an unknown drag and wind as least squares over all ticks do."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.swarm import mission, plugins

NAMES = ("drag", "push_x", "push_y")


def flown(mission_name: str, **options: Any) -> mf.Run:
    settings = {f"controller.{name}": value for name, value in ({"noise": 0.5} | options).items()}
    return mf.fly(mission_name, method="rls", seed=1, duration=40, **settings)


def reported(run: mf.Run, name: str) -> np.ndarray:
    """(T, N)"""
    return np.array(run.frame().column(name).to_pylist(), dtype=np.float64)


def test_averaged_estimates_are_near_the_truth_and_nearer_than_those_of_uavs_alone() -> None:
    shared, alone = flown("unknown"), flown("unknown", share=False)
    wind = shared.scenario.flown().wind
    truth = wind.drag * np.array([1.0, *wind.mean])
    together, apart = (np.array([reported(run, name)[200] for name in NAMES]) for run in (shared, alone))
    assert together.mean(axis=1) == pytest.approx(truth, abs=0.1)  # the prior is zero
    assert alone.summary["payload_bits"]["uplink"] == 0
    off = [np.sqrt(((found - truth[:, None]) ** 2).mean()) for found in (together, apart)]
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


def test_the_uncertainty_never_exceeds_that_before_take_off() -> None:
    """At rest the drag cannot be observed, and forgetting would let its uncertainty grow without end."""
    options = {"controller.forgetting": 0.5}
    run = mf.fly("paper", method="rls", seed=1, uavs=2, duration=120, stop="duration", **options)
    assert run.summary["lost"] == 0
    assert run.summary["arrived"] == 2
    assert np.abs([reported(run, name)[-1] for name in NAMES]).max() < 10.0
