"""The mean-field methods: initial density, interaction, repulsion in flight, and the offline plan."""

from importlib.resources import files
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm, qmc

from meanflock.agent.controllers.mean_field.learner import MeanFieldLearner
from meanflock.agent.controllers.mean_field.methods import Separation
from meanflock.agent.controllers.mean_field.offline import OpenLoopPlan, speeds
from meanflock.kernels.mean_field import layout
from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.swarm import state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.seeds import generator
from meanflock.worldsim.vehicles.point_mass import PointMass

EXPONENTS = np.array([row for row in product(range(5), repeat=4) if 1 <= sum(row) <= 4])
SCALE = np.array([200.0, 200.0, 20.0, 20.0])
BANDWIDTH = np.array([3.0, 3.0, 0.7, 0.7])


def mixture(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The Gaussian mixture; its largest value at a centre is one."""

    def raw(at: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * (((at[:, None] - centres) / BANDWIDTH) ** 2).sum(axis=-1)).sum(axis=-1)

    return raw(points) / raw(centres).max()


@pytest.mark.parametrize("uavs", [1, 2, 7, 25])
def test_no_other_weights_fit_the_samples_better(uavs: int) -> None:
    """The gradient of the least-squares objective vanishes; checked on the sample points every UAV draws."""
    flown = load(None, [f"uavs={uavs}", "density.near_samples=300", "density.box_samples=300"], method="mfgfl-hf")
    weights = MeanFieldLearner(flown).init(3, starts(flown))
    fitted = weights[0, layout.DENSITY][: layout.DENSITY_FEATURES]
    draw, centres = generator(flown.seed, "density-fit"), starts(flown)
    chosen = draw.integers(len(centres), size=300)
    near = centres[chosen] + 2 * BANDWIDTH * draw.standard_normal((300, 4))
    points = np.concatenate([near, SCALE * draw.uniform(-1, 1, (300, 4))])
    features = np.prod((points / SCALE)[:, None, :] ** EXPONENTS, axis=-1)
    error = features @ fitted - mixture(points, centres)
    gradient = features.T @ error / len(points) + flown.density.ridge * fitted
    assert fitted.any()
    assert np.abs(gradient).max() < 1e-9
    assert (weights == weights[0]).all()  # every UAV fits the same
    rest = np.delete(weights[0], np.arange(246)[layout.DENSITY][: layout.DENSITY_FEATURES])
    assert not rest.any()


NODES = np.loadtxt(str(files("meanflock.agent.controllers.mean_field") / "nodes.csv"), delimiter=",")


def direct(flown: Scenario, weights: np.ndarray, at: np.ndarray) -> float:
    """Σ ω_q K(s, s + δ_q) with m̂ evaluated term by term at every node."""
    spread, learner = flown.density, flown.learner
    std = np.array([spread.node_position_std] * 2 + [spread.node_velocity_std] * 2)
    scale = np.array([flown.position_scale_m] * 2 + [learner.velocity_scale] * 2)
    offsets = NODES * std
    points = (at + offsets) / scale
    mass = np.maximum([weights @ np.prod(point**EXPONENTS, axis=1) for point in points], 0.0)
    squared = offsets**2
    kernel = squared[:, 2:].sum(axis=1) / (flown.cost.epsilon + squared[:, :2].sum(axis=1)) ** flown.cost.beta
    return float(mass @ kernel / mass.sum()) if mass.sum() > 0 else 0.0


def test_the_nodes_are_the_scrambled_sobol_points_they_are_said_to_be() -> None:
    sobol = qmc.Sobol(d=4, scramble=True, rng=np.random.default_rng(20200309)).random(64)
    np.testing.assert_allclose(NODES, norm.ppf(sobol), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("cost.epsilon=2.5", "cost.beta=0.5"),
        ("cost.beta=0",),
        ("density.node_position_std=30", "density.node_velocity_std=4"),
        ("learner.position_scale=150", "learner.velocity_scale=10"),
    ],
)
def test_the_quadrature_is_the_density_evaluated_at_every_node(settings: tuple[str, ...]) -> None:
    flown = load(None, ["uavs=9", "method=mfg", *settings])
    draw = np.random.default_rng(1)
    rows = 12
    learner = MeanFieldLearner(flown)
    weights = learner.init(rows, starts(flown))
    states = draw.uniform([-150, -150, -9, -9], [160, 110, 9, 9], (rows, 4))
    states[0] = 0.0
    for _ in range(3):
        densities = weights[:, layout.DENSITY][:, : layout.DENSITY_FEATURES]
        expected = [direct(flown, w, s) for w, s in zip(densities, states, strict=True)]
        weights, numbers = learner.step(weights, states, None)
        np.testing.assert_allclose(numbers[:, 4], expected, rtol=1e-9, atol=1e-12)
        states = states + draw.normal(0, 1, states.shape)
    assert np.ptp(expected) > 0


@pytest.mark.parametrize("beta", [1.0, 0.5])
def test_with_hjb_phi_g_is_the_mean_over_the_states_a_uav_knows(beta: float) -> None:
    draw = np.random.default_rng(3)
    learner = MeanFieldLearner(load(None, ["uavs=4", f"cost.beta={beta}"], method="hjb"), learns_density=False)
    states, known = draw.normal(0, 5, (2, 4)), draw.normal(0, 5, (2, 4, 4))
    apart = known - states[:, None]
    kernel = (apart[..., 2:] ** 2).sum(axis=-1) / (1 + (apart[..., :2] ** 2).sum(axis=-1)) ** beta
    phi_g = learner.step(learner.init(2, known[0]), states, known)[1][:, 4]
    np.testing.assert_allclose(phi_g, kernel.mean(axis=-1), rtol=1e-12)


NONE = np.zeros(0, dtype=np.intp)


def test_a_swarm_that_would_touch_rarely_does() -> None:
    flights = [load(None, ["duration=60", *more], method="mfgfl-hf") for more in ((), ("cost.separation=5",))]
    without, apart = (Engine(flown, "separation").complete()["collisions"] for flown in flights)
    assert apart < without / 3


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


@given(
    distance=st.floats(0.01, 500.0),
    speed_max=st.floats(0.5, 50.0),
    acceleration_max=st.floats(0.1, 30.0),
    dt=st.floats(0.05, 1.0),
)
def test_profile_covers_the_distance_within_the_limits_and_no_faster_one_would(
    distance: float, speed_max: float, acceleration_max: float, dt: float
) -> None:
    profile = speeds(distance, speed_max, acceleration_max, dt)
    assert profile.sum() * dt == pytest.approx(distance, rel=1e-9)
    assert profile.max() <= speed_max * (1 + 1e-12)
    from_rest = np.concatenate([[0.0], profile])
    assert np.abs(np.diff(from_rest)).max() <= acceleration_max * dt * (1 + 1e-9)
    assert profile[-1] == pytest.approx(0.0, abs=1e-12)
    ticks = len(profile) - 1
    k = np.arange(1, ticks + 1)
    reach = np.minimum(np.minimum(k, ticks - k) * (acceleration_max * dt), speed_max).sum() * dt
    assert reach < distance


def test_without_randomness_the_discrete_motion_ends_at_rest_at_the_origin() -> None:
    scenario = load(None, ["wind.sigma=0"], method="offline")
    states = starts(scenario)
    plan, vehicle = OpenLoopPlan(scenario, states), PointMass(PointMass.Options(), scenario)
    straight = -state.position(states) / np.linalg.norm(state.position(states), axis=-1, keepdims=True)
    assert len(plan) * 0.1 == pytest.approx(np.linalg.norm([150, 100]) / 15 + 15 / 3, abs=0.5)  # bang, coast, bang
    for tick in range(len(plan) + 20):
        states, _ = vehicle.step(states, {}, plan(tick), np.zeros((25, 2)))
        across = states[:, 0] * straight[:, 1] - states[:, 1] * straight[:, 0]
        assert np.abs(across).max() < 1e-9
    assert np.abs(states).max() < 1e-9


@pytest.mark.parametrize(
    ("method", "usual", "exchanged"), [("mfgfl-hf", 200, 100), ("mfgfl-h", 100, 200), ("mfgfl-f", 100, 200)]
)
def test_exchanged_rounds_give_both_models_the_length_of_one_and_one_that_of_both(
    method: str, usual: int, exchanged: int
) -> None:
    key = "learner.exchanged_rounds=true"
    assert load(None, method=method).period_ticks == usual
    assert load(None, [key], method=method).period_ticks == exchanged
    assert load(Path("paper-exchanged"), method=method).resolved().federation.period == exchanged
    assert load(None, [key, "federation.period=30"], method=method).period_ticks == 30


@pytest.mark.parametrize(("method", "separation"), [("hjb", 0), ("mfg", 0), ("mfgfl-hf", 3)])
def test_commands_are_held_back_for_the_first_seconds_while_uavs_learn(method: str, separation: float) -> None:
    """Before `act_after_s` the swarm flies as without commands; its weights change, and commands begin on time."""
    keys = ["uavs=4", "duration=3", "start.spacing=0.3", f"cost.separation={separation}", "learner.act_after_s=1.5"]
    kept = StoredTelemetry()
    engine = Engine(load(None, keys, method=method), "held", sinks=[kept])
    engine.complete()
    commands = np.concatenate([block.accelerations for block in kept.blocks])[1:]  # of ticks 0, 1, …
    assert not commands[:15].any()
    assert commands[15].all()
    unhindered = StoredTelemetry()
    Engine(load(None, keys[:-1], method=method), "free", sinks=[unhindered]).complete()
    assert np.concatenate([block.accelerations for block in unhindered.blocks])[2].all()
