"""Commands of controllers, compared with values worked by hand and with other implementations."""

from typing import Any

import numpy as np
import pyrvo
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

import meanflock as mf
from meanflock.agent.controllers.lqr import gains
from meanflock.agent.controllers.sharing.bvc import BufferedVoronoi
from meanflock.agent.controllers.sharing.orca import Orca
from meanflock.agent.controllers.sharing.potential_field import repulsion
from meanflock.agent.controllers.sharing.vasarhelyi import braking
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from tests.agent.controllers.by_hand import DISCS, accelerations, made

# -- alone -------------------------------------------------------------------------------------------------------


def test_far_off_it_flies_at_cruise_speed_and_near_the_goal_slower() -> None:
    states = np.array([[300.0, 400.0, 0, 0], [0.0, -5.5, 0, 0], [6.0, 0.0, 1.0, 2.0], [0, 0, 0, 0]])
    wanted = np.array([[-0.6 * 2.25, -0.8 * 2.25], [0.0, 2.25], [-2.25 - 1.0, -2.0], [0.0, 0.0]])
    np.testing.assert_allclose(accelerations("cruise", states), wanted, rtol=1e-12)
    slow = accelerations("cruise", states[1:2], "controller.slowing_1_s=0.1", "controller.velocity_gain_1_s=3")
    np.testing.assert_allclose(slow, [[0.0, 3 * 0.55]], rtol=1e-12)


def test_it_stays_where_it_arrives() -> None:
    run = mf.fly("paper", method="cruise", uavs=1, duration=120, stop="duration", **{"wind.sigma": 0.0})
    arrived = np.flatnonzero(np.sqrt((run.states[:, 0] ** 2).sum(axis=-1)) <= 5.0)[0]
    end = run.states[-1, 0, :2]
    assert np.hypot(*(end - run.states[arrived, 0, :2])) < 1.0
    assert np.hypot(*end) > 2.0
    assert np.hypot(*run.states[-1, 0, 2:]) < 1e-3
    assert run.summary["payload_bits"]["total"] == 4 * 32  # the mission plan, before take-off


@pytest.mark.parametrize("method", ["cruise", "lqr", "plan", "vasarhelyi", "olfati-saber", "potential-field"])
def test_each_comes_to_a_goal_of_its_own(method: str) -> None:
    goals = [[40.0, -10.0], [0.0, 30.0], [-20.0, 5.0]]
    way = {"start.positions": [[60.0, 0.0], [30.0, 60.0], [20.0, -30.0]], "destination.positions": goals}
    run = mf.fly("paper", method=method, uavs=3, **way)
    assert run.summary["arrived"] == 3
    assert (np.hypot(*(run.states[-1, :, :2] - goals).T) < 5.0).all()


@given(position=st.floats(1e-6, 1e3), velocity=st.floats(0.0, 1e3))
def test_the_closed_form_solves_the_riccati_equation(position: float, velocity: float) -> None:
    push = np.array([[0.0], [1.0]])
    p = solve_continuous_are(np.array([[0.0, 1.0], [0.0, 0.0]]), push, np.diag([position, velocity]), np.eye(1))
    np.testing.assert_allclose(gains(position, velocity), (push.T @ p)[0], rtol=1e-5)


# -- beside other UAVs and discs -------------------------------------------------------------------------------------

TAU = 0.4


@given(slope=st.floats(0.1, 10.0), most=st.floats(0.1, 10.0), distance=st.floats(0.0, 50.0))
def test_from_the_allowed_speed_a_uav_stops_within_the_distance(slope: float, most: float, distance: float) -> None:
    """Braking along D takes at most `most` m/s², and it never turns round."""
    ways = np.linspace(0.0, distance, 2000)
    speed = braking(ways, slope, most)
    assert speed[0] == 0.0
    assert (np.diff(speed) >= 0.0).all()
    deceleration = 0.5 * np.diff(speed**2) / np.maximum(np.diff(ways), 1e-12)  # v dv/dr
    assert deceleration.max() <= most * (1 + 1e-6)
    assert not braking(-ways, slope, most).any()


def test_a_uav_that_closes_in_too_fast_is_slowed() -> None:
    """At 2.5 m the brake allows √(2·0.5·2 − 1/9) = 1.374 m/s; half of the rest is taken off."""
    states = np.array([[70.0, 0.0, 1.0, 0.0], [72.5, 0.0, -1.0, 0.0]])
    push = accelerations("vasarhelyi", states) * TAU - accelerations("cruise", states)
    rest = 0.5 * (2.0 - np.sqrt(2.0 - 1.0 / 9.0))
    np.testing.assert_allclose(push, [[-rest, 0.0], [rest, 0.0]], rtol=1e-9)


def test_an_obstacle_repels_by_agents_that_move_away_from_its_edge() -> None:
    far, near = np.array([[60.0, 0.0, -2.0, 0.0]]), np.array([[12.4, 0.0, -2.0, 0.0]])
    free, met = (accelerations("vasarhelyi", states, DISCS) for states in (far, near))
    np.testing.assert_allclose(free, accelerations("vasarhelyi", far), atol=1e-12)
    np.testing.assert_allclose((met - accelerations("vasarhelyi", near)) * TAU, [[2.0 + 4.0, 0.0]], rtol=1e-9)


UNLIMITED = "controller.acceleration_max_m_s2=1e9"
ALONE = (UNLIMITED, "controller.pull_m_s2=1e-12", "controller.damping_1_s=1e-12")


def pair(distance: float, *settings: str) -> np.ndarray:
    states = np.array([[0.0, 0, 0, 0], [distance, 0, 0, 0]])
    return accelerations("olfati-saber", states, *ALONE, *settings)


def test_a_pair_is_repelled_within_the_distance_attracted_beyond_and_at_rest_at_it() -> None:
    with pytest.raises(BadInput, match=r"`a` 9\.0 is greater than `b` 8\.0"):
        made("olfati-saber", "controller.a=9.0")
    np.testing.assert_allclose(pair(1.3), 0.0, atol=1e-10)
    assert pair(0.9)[0, 0] < -0.1
    assert pair(1.42)[0, 0] > 1e-3
    np.testing.assert_allclose(pair(1.57), 0.0, atol=1e-10)
    np.testing.assert_allclose(pair(0.0), 0.0, atol=1e-10)


def test_the_force_of_a_pair_is_that_of_the_source() -> None:
    """At 0.9 m, worked by hand: ‖z‖σ = (√(1+.1·.81) − 1)/.1 and so on."""
    sigma, lattice, reach = ((np.sqrt(1 + 0.1 * d * d) - 1) / 0.1 for d in (0.9, 1.3, 1.56))
    weight = 0.5 * (1 + np.cos(np.pi * (sigma / reach - 0.2) / 0.8))
    z = sigma - lattice
    force = weight * 8.0 * z / np.sqrt(1 + z * z) * 0.9 / np.sqrt(1 + 0.1 * 0.81)
    np.testing.assert_allclose(pair(0.9), [[force, 0.0], [-force, 0.0]], rtol=1e-9, atol=1e-10)


def test_an_obstacle_repels_and_slows_a_uav_that_comes_near() -> None:
    far, near = np.array([[20.0, 0.0, -2.0, 0.0]]), np.array([[12.5, 0.0, -2.0, 1.0]])
    np.testing.assert_array_equal(accelerations("olfati-saber", far, DISCS), accelerations("olfati-saber", far))
    push = accelerations("olfati-saber", near, DISCS, UNLIMITED) - accelerations("olfati-saber", near)
    assert push[0, 0] > 1.0
    np.testing.assert_allclose(push[0, 1], -0.5 * 0.2, rtol=1e-9)  # along the edge the agent is a fifth slower


@given(rho=st.floats(0.05, 4.9), rho0=st.floats(0.2, 5.0), eta=st.floats(0.1, 10.0))
def test_the_force_is_the_slope_of_the_potential(rho: float, rho0: float, eta: float) -> None:
    def potential(at: float) -> float:
        return 0.5 * eta * (1.0 / at - 1.0 / rho0) ** 2 if at < rho0 else 0.0

    step = 1e-5 * rho
    slope = (potential(rho - step) - potential(rho + step)) / (2 * step)
    force = float(repulsion(np.array([rho]), rho0, eta, np.inf)[0])
    assert abs(force - slope) <= 1e-4 * max(abs(slope), eta / rho**2 * 1e-2, eta / rho0**2)


def test_the_force_is_limited_and_points_out_of_a_disc_that_was_entered() -> None:
    forces = repulsion(np.array([-1.0, 0.0, 1e-6, 0.3, 2.0, 9.0]), 2.0, 1.0, 3.0)
    assert forces.tolist() == [3.0, 3.0, 3.0, 3.0, 0.0, 0.0]
    inside = np.array([[11.0, 0.5, 0.0, 0.0]])
    push = accelerations("potential-field", inside, DISCS) - accelerations("potential-field", inside)
    assert push[0, 0] > 2.0
    assert push[0, 1] > 1.0


SPEED_MAX = 4.0


def by_pyrvo(own: np.ndarray, wished: np.ndarray, radius: float, horizon: float) -> np.ndarray:
    simulator = pyrvo.RVOSimulator(0.1, 15.0, 10, horizon, horizon, radius / 2.0, SPEED_MAX)
    for number, (state, velocity) in enumerate(zip(own.tolist(), wished.tolist(), strict=True)):
        simulator.add_agent((state[0], state[1]))
        simulator.set_agent_velocity(number, (state[2], state[3]))
        simulator.set_agent_pref_velocity(number, (velocity[0], velocity[1]))
    simulator.do_step()
    return np.array([tuple(simulator.get_agent_velocity(number).to_tuple()) for number in range(len(own))])


def ours(own: np.ndarray, wished: np.ndarray, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    made = Orca(Orca.Options(speed_max_m_s=SPEED_MAX, **options), Scenario(uavs=len(own)))
    return made.velocity(own, np.repeat(own[None], len(own), axis=0), np.arange(len(own)), wished)


@pytest.mark.parametrize(("radius", "horizon"), [(0.7, 1.0), (0.9, 3.0)])
@pytest.mark.parametrize("spread", [1.0, 2.5, 6.0])  # most touch; some do; few are near
def test_velocities_are_those_of_pyrvo(radius: float, horizon: float, spread: float) -> None:
    """10⁴ and more; it computes in single precision, and takes for parallel what is 1e-5 apart."""
    draw = np.random.default_rng(int(10 * spread + horizon))
    errors, feasible = [], []
    while len(errors) < 1700:
        uavs = int(draw.integers(2, 9))
        own = draw.normal(size=(uavs, 4)) * [spread, spread, 1.5, 1.5]
        wished = 1.5 * draw.normal(size=(uavs, 2))
        velocity, missing = ours(own, wished, radius_m=radius, horizon_s=horizon)
        errors += np.linalg.norm(velocity - by_pyrvo(own, wished, radius, horizon), axis=1).tolist()
        feasible += (missing <= 0.0).tolist()
    assert np.median(errors) < 3e-7
    assert sum(feasible) > 400
    assert np.quantile(np.array(errors)[feasible], 0.99) < 1e-4
    assert np.quantile(errors, 0.95) < 1e-2


@pytest.mark.parametrize("speed", [2.25, 4.0])
def test_two_uavs_head_on_stop_in_their_cells(speed: float) -> None:
    scenario = load(None, ["uavs=2", "wind.sigma=0", "wind.drag=0", "vehicle.acceleration_max=3"])
    options = BufferedVoronoi.Options(radius_m=0.5, right_bias=0.0, velocity_gain_1_s=4.0, speed_m_s=speed)
    controller = BufferedVoronoi(options, scenario)
    own = np.array([[10.0, 0.0, speed, 0.0], [30.0, 0.0, -speed, 0.0]])
    memory = controller.init(np.arange(2), own) | {"travel_end": np.array([[40.0, 0.0], [0.0, 0.0]])}
    for _ in range(150):
        everyone = np.repeat(own[None], 2, axis=0)
        acceleration = controller.fly(memory, own, everyone).acceleration
        assert (np.linalg.norm(acceleration, axis=1) <= 3.0 + 1e-9).all()
        own = np.concatenate([own[:, :2] + 0.1 * own[:, 2:], own[:, 2:] + 0.1 * acceleration], axis=1)
        assert own[0, 0] < 20.0 - 0.35  # the lag of the velocity carries it up to 11 cm beyond
    assert own[1, 0] - own[0, 0] == pytest.approx(1.0, abs=0.1)
