"""rls and fed-lspi: recursive least squares, policy iteration, and what both learn in flight."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.planned import fed_lspi as lspi
from meanflock.settings import scenario_of
from meanflock.swarm import mission, plugins

NAMES = ("drag", "push_x", "push_y")


def identified(mission_name: str, **options: Any) -> mf.Run:
    settings = {f"controller.{name}": value for name, value in ({"noise": 0.5} | options).items()}
    return mf.fly(mission_name, method="rls", seed=1, duration=40, **settings)


def reported(run: mf.Run, name: str) -> np.ndarray:
    """(T, N)"""
    return np.array(run.frame().column(name).to_pylist(), dtype=np.float64)


def test_averaged_estimates_are_near_the_truth_and_nearer_than_those_of_uavs_alone() -> None:
    shared, alone = identified("unknown"), identified("unknown", share=False)
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


def flown(seed: int, **options: Any) -> mf.Run:
    settings = {f"controller.{name}": value for name, value in options.items()}
    return mf.fly(mf.Scenario(), method="fed-lspi", seed=seed, **settings)


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
