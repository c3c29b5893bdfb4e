"""A plan that everybody knows is flown together, without a word and without a collision."""

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.planned.plan import Plan
from meanflock.agent.controllers.sharing.base import Neighbours
from meanflock.swarm import declared, mission
from meanflock.swarm.scenario import load
from meanflock.swarm.scenario.tables import Sharing


def test_without_noise_it_keeps_to_its_trajectory() -> None:
    run = mf.fly("paper", method="plan", uavs=9, stop="duration", duration=110, **{"wind.sigma": 0.0})
    plan: Plan = declared.controller(load(None, ["uavs=9"], method="plan"))
    wanted = np.array(
        [
            plan.prediction().now(np.zeros((1, 4, 9)), np.zeros((1, 9), np.int32), slice(None), tick)[0].T
            for tick in range(len(run.states))
        ]
    )
    assert np.abs(run.states - wanted).max() < 0.12  # a tick at full acceleration, and the ends of the trapezoid
    assert np.abs(run.states[-1] - wanted[-1]).max() < 1e-6
    assert not run.states[-1, :, 2:].round(6).any()


@pytest.mark.parametrize("uavs", [1, 2, 25])
def test_all_arrive_together_apart_and_in_silence(uavs: int) -> None:
    run = mf.fly("paper", method="plan", uavs=uavs)
    summary = run.summary
    assert summary["arrived"] == uavs
    assert summary["collisions"] == 0
    assert summary["t_max_s"] - summary["t_avg_s"] < 3.0
    assert summary["radio"]["traffic"]["state"]["sent"] == 0


def test_a_gust_throws_it_off_but_not_for_long() -> None:
    gust = {"kind": "gust", "time_s": 20.0, "duration_s": 1.0, "acceleration": [0.0, 3.0]}
    calm, gusty = (
        mf.fly("paper", method="plan", uavs=4, duration=40, faults=faults, **{"wind.sigma": 0.0})
        for faults in ([], [gust])
    )
    off = np.hypot(*(gusty.states - calm.states)[:, 0, :2].T)
    assert 0.3 < off.max() < 1.0
    assert off[-1] < 1e-6


def test_who_tells_neighbours_of_it_hardly_ever_has_to_speak() -> None:
    """Others predict by the plan; at constant velocity every bend of it would be an event."""
    scenario = load(None, ["uavs=9"], method="plan")
    states = mf.fly(scenario, seed=3).states
    plan: Plan = declared.controller(scenario)
    said = {}
    sharing = msgspec.structs.replace(scenario, sharing=Sharing(policy="event"))
    for name, predict in (("plan", plan.prediction()), ("velocity", None)):
        of = Neighbours(sharing, predict)
        memory, said[name] = of.init(np.arange(9), mission.starts(scenario)), 0
        for tick, own in enumerate(states):
            memory, broadcast = of.speak(memory, tick, own)
            said[name] += len(broadcast.payload)
    assert said["plan"] < 0.2 * said["velocity"]


def test_the_clock_starts_when_a_uav_leaves_the_ground() -> None:
    waves = {"start.formation": "waves", "start.group": 2, "start.interval": 3.0}
    run = mf.fly("paper", method="plan", uavs=4, **waves, **{"wind.sigma": 0.0})
    moving = np.hypot(*np.moveaxis(run.states[..., 2:], -1, 0)) > 1e-3
    first = moving.argmax(axis=0)
    assert (first[2:] - first[:2]).tolist() == [30, 30]
    assert run.summary["collisions"] == 0
    assert run.summary["arrived"] == 4
