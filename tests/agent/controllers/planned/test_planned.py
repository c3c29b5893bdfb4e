"""The plan and how it is flown; what rls and fed-lspi, which follow it, learn in flight."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import meanflock as mf
from meanflock.agent.controllers.cruise import CRUISE_M_S
from meanflock.agent.controllers.planned import fed_lspi as lspi
from meanflock.agent.controllers.planned.plan import PlanFollower, Trajectory, Trapezoid, slots
from meanflock.settings import scenario_of
from meanflock.swarm import declared, mission, plugins
from meanflock.swarm.scenario import Scenario


@given(length=st.floats(0.0, 500.0), cruise=st.floats(0.1, 20.0), up=st.floats(0.1, 5.0), down=st.floats(0.1, 5.0))
def test_a_way_is_covered_from_rest_to_rest_within_the_limits(
    length: float, cruise: float, up: float, down: float
) -> None:
    profile = Trapezoid(np.array([length]), cruise, up, down)
    end = float(profile.duration_s[0])
    times = np.linspace(0.0, end, 200)
    covered, speed, change = np.array([profile.at(t) for t in times])[..., 0].T
    assert covered[0] == 0.0
    assert covered[-1] == pytest.approx(length, abs=1e-9)
    assert (np.diff(covered) >= -1e-9).all()
    assert speed.max() <= cruise * (1 + 1e-12)
    assert change.max() <= up
    assert change.min() >= -down
    # the speed is the slope of the way: the trapezoid rule is exact but in the two intervals with a corner
    slope = 0.5 * (speed[1:] + speed[:-1]) * np.diff(times)
    corner = (up + down) * (end / 199) ** 2
    assert np.abs(np.diff(covered)[:-1] - slope[:-1]).max(initial=0.0) <= corner + 1e-9
    for before_or_after in (-1.0, end + 1.0):
        assert [float(part[0]) for part in profile.at(before_or_after)[1:]] == [0.0, 0.0]


@pytest.mark.parametrize("uavs", [1, 25, 64])
def test_all_uavs_arrive_together_and_keep_apart(uavs: int) -> None:
    scenario = Scenario(uavs=uavs)
    plan = mission.starts(scenario)
    trajectory = Trajectory(scenario, plan)
    positions = np.array([trajectory.states(tick)[:, :2] for tick in range(0, 1000, 5)])
    assert (positions[0] == plan[:, :2]).all()
    assert positions[-1] == pytest.approx(trajectory.slots, abs=1e-9)
    assert np.hypot(*trajectory.slots.T).max() <= 0.84 * scenario.destination.radius + 1e-9
    apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    apart[:, np.arange(uavs), np.arange(uavs)] = np.inf
    ends = min(apart[0].min(), apart[-1].min())
    assert uavs == 1 or apart.min() >= ends - 1e-9
    states, change = trajectory.at(200)
    assert np.hypot(*states[:, 2:].T) == pytest.approx(CRUISE_M_S, rel=0.05)
    assert (change == 0.0).all()


def test_slots_are_the_formation_of_the_uavs_with_the_same_goal_made_smaller() -> None:
    starts = np.array([[0.0, 0.0], [2.0, 0.0], [100.0, 0.0], [100.0, 80.0], [5.0, 5.0]])
    goals = np.array([[9.0, 9.0], [9.0, 9.0], [-9.0, 0.0], [-9.0, 0.0], [1.0, 2.0]])
    ends = slots(starts, goals, 4.0)
    assert ends == pytest.approx(np.array([[8, 9], [10, 9], [-9, -4], [-9, 4], [1, 2]]))


def test_without_noise_it_keeps_to_its_trajectory() -> None:
    waves = {"start.formation": "waves", "start.group": 5, "start.interval": 3.0, "wind.sigma": 0.0}
    run = mf.fly("paper", method="plan", uavs=9, stop="duration", duration=115, **waves)
    plan: PlanFollower = declared.controller(run.scenario)
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


NAMES = ("drag", "push_x", "push_y")


def reported(run: mf.Run, name: str) -> np.ndarray:
    """(T, N)"""
    return np.array(run.frame().column(name).to_pylist(), dtype=np.float64)


def test_averaged_estimates_are_near_the_truth_and_nearer_than_those_of_uavs_alone() -> None:
    fixed = {"method": "rls", "seed": 1, "duration": 40, "controller.noise": 0.5}
    shared, alone = (mf.fly("unknown", **fixed, **more) for more in ({}, {"controller.share": False}))
    wind = shared.scenario.flown().wind
    truth = wind.drag * np.array([1.0, *wind.mean])
    together, apart = (np.array([reported(run, name)[200] for name in NAMES]) for run in (shared, alone))
    assert together.mean(axis=1) == pytest.approx(truth, abs=0.1)  # the prior is zero
    assert alone.summary["payload_bits"]["uplink"] == 0
    off = [np.sqrt(((found - truth[:, None]) ** 2).mean()) for found in (together, apart)]
    assert off[0] < 0.7 * off[1]


def test_it_is_least_squares_with_a_prior() -> None:
    """The recursion over a flight by hand, beside the normal equations of all its ticks at once."""
    controller: Any = plugins.create("controller", "rls", {"share": False}, Scenario())
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


DT, DISCOUNT = 0.1, 0.95


def riccati(drag: float, push: float = 0.0) -> tuple[float, float, float]:
    """(k1, k2, k3) of one axis: v' = v + dt(u − c0 v + d), p' = p + dt v', cost p² + ½v² + ½u² discounted by γ."""
    damped = 1.0 - drag * DT
    a = np.array([[1.0, DT * damped, DT * DT * push], [0.0, damped, DT * push], [0.0, 0.0, 1.0]])
    b = np.array([[DT * DT], [DT], [0.0]])
    q, value = np.diag([1.0, 0.5, 0.0]), np.zeros((3, 3))
    for _ in range(5000):
        gain = DISCOUNT * np.linalg.solve(0.5 + DISCOUNT * b.T @ value @ b, b.T @ value @ a)
        value = q + DISCOUNT * a.T @ value @ a - DISCOUNT * a.T @ value @ b @ gain
    return tuple(gain[0].tolist())


def observed(rows: int, ticks: int, drag: float, push: tuple[float, float], noise: float) -> tuple[np.ndarray, ...]:
    """M1 and M2 of rows that fly with the first gains and perturbed inputs."""
    draw = np.random.default_rng(3)
    gains = np.tile([0.3, 1.0, 0.0, 0.0], (rows, 1))
    squares, steps = np.zeros((rows, 14, 14)), np.zeros((rows, 14, 9))
    error = np.zeros((rows, 2, 2))
    for _ in range(ticks):
        given = lspi.inputs(gains, error) + 0.3 * draw.standard_normal((rows, 2))
        v = error[..., 1] + DT * (given - drag * error[..., 1] + push)
        v += noise * np.sqrt(DT) * draw.standard_normal((rows, 2))
        then = np.stack([error[..., 0] + DT * v, v], axis=-1)
        first, second = lspi.seen(error, given, then)
        squares, steps, error = squares + first, steps + second, then
    return squares, steps


def improved(squares: np.ndarray, steps: np.ndarray, rounds: int = 12) -> np.ndarray:
    gains = np.tile([0.3, 1.0, 0.0, 0.0], (len(squares), 1))
    for _ in range(rounds):
        gains = lspi.improve(gains, squares, steps, DISCOUNT, 2.0, 0.3)
    return gains


@pytest.mark.parametrize(("drag", "push"), [(0.1, (0.285, -0.02)), (0.3, (1.2, 0.4)), (0.0, (0.0, -0.7))])
def test_without_noise_the_best_gains_are_found(drag: float, push: tuple[float, float]) -> None:
    gains = improved(*observed(1, 60, drag, push, 0.0))[0]
    k1, k2, along_x = riccati(drag, push[0])
    assert gains == pytest.approx([k1, k2, along_x, riccati(drag, push[1])[2]], rel=1e-3, abs=1e-3)


def test_a_step_changes_gains_by_at_most_its_limits() -> None:
    squares, steps = observed(4, 300, 0.3, (2.5, -2.5), 0.1)
    before = np.tile([0.1, 5.0, -1.0, 1.0], (4, 1))
    after = lspi.improve(before, squares, steps, DISCOUNT, 1.5, 0.2)
    assert (after[:, 0] == 0.1 * 1.5).all()
    assert (after[:, 1] == 5.0 / 1.5).all()
    assert np.abs(after[:, 2:] - before[:, 2:]).max() <= 0.2 * (1 + 1e-12)


def test_a_uav_without_usable_observations_keeps_its_gains() -> None:
    gains = np.tile([0.3, 1.0, 0.0, 0.0], (3, 1))
    squares, steps = np.zeros((3, 14, 14)), np.zeros((3, 14, 9))
    squares[1], steps[2] = np.inf, np.nan
    with np.errstate(all="ignore"):
        after = lspi.improve(gains, squares, steps, DISCOUNT, 2.0, 0.3)
    assert (after[1:] == gains[1:]).all()
    assert np.isfinite(after).all()


def test_absurd_gains_are_flown_at_their_bounds() -> None:
    error = np.ones((1, 2, 2))
    assert np.abs(lspi.inputs(np.full((1, 4), 1e8), error)).max() <= 23.0


GAINS = ("k1", "k2", "k3_x", "k3_y")
BEST = np.array([0.922, 1.297, 0.244, 0.0])  # of the Riccati equation above


def test_all_arrive_with_gains_near_the_best_and_follow_the_plan_better_than_with_their_own_alone() -> None:
    shared, alone = (mf.fly("paper", method="fed-lspi", seed=1, **more) for more in ({}, {"controller.share": False}))
    assert shared.summary["arrived"] == 25
    assert shared.summary["t_avg_s"] == pytest.approx(79.6, abs=0.2)
    assert shared.summary["rounds"] == 40
    assert 0 < shared.summary["payload_bits"]["uplink"] <= 40 * 20 * 4 * 32  # four numbers a round
    assert alone.summary["payload_bits"]["uplink"] == 0
    mean = np.array([reported(shared, name)[780].mean() for name in GAINS])
    assert mean[:3] == pytest.approx(BEST[:3], rel=0.2)
    assert mean[3] == pytest.approx(0.0, abs=0.05)
    together, apart = (reported(run, "tracking_cost")[:790].sum() for run in (shared, alone))
    assert together < 0.7 * apart
    spread = [np.std(reported(run, "k3_y")[200:790], axis=1).mean() for run in (shared, alone)]
    assert spread[0] < 0.3 * spread[1]


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
