"""fed-lspi in flight: it finds the best gains without knowing drag and wind, and sharing makes it better."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.planned.plan import Trajectory
from meanflock.settings import scenario_of
from meanflock.swarm import mission, plugins

GAINS = ("k1", "k2", "k3_x", "k3_y")
BEST = np.array([0.922, 1.297, 0.244, 0.0])  # of a Riccati equation, see test_fed_lspi_policies.py


def flown(seed: int, **options: Any) -> mf.Run:
    settings = {f"controller.{name}": value for name, value in options.items()}
    return mf.fly(mf.Scenario(), method="fed-lspi", seed=seed, **settings)


def reported(run: mf.Run, name: str) -> np.ndarray:
    """(T, N)"""
    return np.array(run.frame().column(name).to_pylist(), dtype=np.float64)


@pytest.fixture(scope="module")
def shared() -> mf.Run:
    return flown(1)


def test_all_arrive_with_gains_near_the_best_and_send_four_numbers_a_round(shared: mf.Run) -> None:
    assert shared.summary["arrived"] == 25
    assert shared.summary["t_avg_s"] == pytest.approx(79.6, abs=0.2)
    assert shared.summary["rounds"] == 40
    assert 0 < shared.summary["payload_bits"]["uplink"] <= 40 * 20 * 4 * 32
    mean = np.array([reported(shared, name)[780].mean() for name in GAINS])
    assert mean[:3] == pytest.approx(BEST[:3], rel=0.2)
    assert mean[3] == pytest.approx(0.0, abs=0.05)


def test_shared_gains_follow_the_plan_better_than_own_ones(shared: mf.Run) -> None:
    alone = flown(1, share=False)
    assert alone.summary["payload_bits"]["uplink"] == 0
    together, apart = (reported(run, "tracking_cost")[:790].sum() for run in (shared, alone))
    assert together < 0.7 * apart
    spread = [np.std(reported(run, "k3_y")[200:790], axis=1).mean() for run in (shared, alone)]
    assert spread[0] < 0.3 * spread[1]


def test_the_tracking_cost_is_that_of_the_states(shared: mf.Run) -> None:
    trajectory = Trajectory(shared.scenario, mission.starts(shared.scenario))
    off = shared.states[300] - trajectory.states(300)
    expected = (off[:, :2] ** 2).sum(axis=1) + 0.5 * (off[:, 2:] ** 2).sum(axis=1)
    assert reported(shared, "tracking_cost")[301] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("method", "seen"), [("fed-lspi", ("squares", 9)), ("rls", ("covariance", 1))])
def test_the_ground_and_a_pause_teach_nothing(method: str, seen: tuple[str, int]) -> None:
    start = {"start.formation": "waves", "start.interval": 10.0, "start.group": 5}
    controller: Any = plugins.create("controller", method, {}, scenario_of("paper", start, uavs=10))
    plan = mission.starts(controller.scenario)
    memory, numbers = controller.init(np.arange(10), plan), []
    for tick in (0, 1, 2, 7, 8):
        memory = controller.step(memory, tick, plan, ()).memory
        numbers.append(memory[seen[0]][:, seen[1], seen[1]])
    learned = np.diff(np.array(numbers), axis=0) != 0.0
    assert learned[:, :5].all(axis=1).tolist() == [True, True, False, True]
    assert not learned[:, 5:].any()
