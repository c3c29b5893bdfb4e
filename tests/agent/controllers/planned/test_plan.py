"""A plan that all UAVs know is flown without a message and without a collision."""

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.planned.plan import Plan
from meanflock.swarm import declared


def test_without_noise_it_keeps_to_its_trajectory() -> None:
    waves = {"start.formation": "waves", "start.group": 5, "start.interval": 3.0, "wind.sigma": 0.0}
    run = mf.fly("paper", method="plan", uavs=9, stop="duration", duration=115, **waves)
    plan: Plan = declared.controller(run.scenario)
    wanted = np.array(
        [
            plan.prediction().now(np.zeros((1, 4, 9)), np.zeros((1, 9), np.int32), slice(None), tick)[0].T
            for tick in range(len(run.states))
        ]
    )
    assert np.abs(run.states - wanted).max() < 0.12  # a tick at full acceleration, and the ends of the trapezoid
    assert np.abs(run.states[-1] - wanted[-1]).max() < 1e-6
    assert not run.states[-1, :, 2:].round(6).any()
    first = (np.hypot(run.states[..., 2], run.states[..., 3]) > 1e-3).argmax(axis=0)
    assert (first - first[0]).tolist() == [0] * 5 + [30] * 4  # the clock starts when a UAV leaves the ground


@pytest.mark.parametrize("uavs", [1, 25])
def test_all_arrive_together_apart_and_in_silence(uavs: int) -> None:
    run = mf.fly("paper", method="plan", uavs=uavs)
    summary = run.summary
    assert summary["arrived"] == uavs
    assert summary["collisions"] == 0
    assert summary["t_max_s"] - summary["t_avg_s"] < 3.0
    assert summary["radio"]["traffic"]["state"]["sent"] == 0
