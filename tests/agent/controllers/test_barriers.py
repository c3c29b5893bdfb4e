"""The filter of control barrier functions: the conditions of the source, and what it does where they cannot be kept."""

from collections.abc import Sequence
from typing import Any

import daqp
import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.barriers import Barrier, Braking, Ecbf
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.controllers.sharing.nearby import closest, closest_discs
from meanflock.swarm.scenario import Destination, Filter, Obstacle, Scenario, Sharing, Start, Wind, load
from meanflock.swarm.scenario import files as scenario_files

AIR = Wind(drag=0.3, mean=(3.0, -2.0))


class Wishes(Controller):
    """Commands what its option says."""

    name = "wishes"
    broadcast_numbers = 0

    def __init__(self, wanted: np.ndarray, scenario: Scenario) -> None:
        super().__init__(None, scenario)
        self.wanted = wanted

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        return Step(memory, self.wanted)


def filtered(scenario: Scenario, kind: type[Barrier] = Ecbf, **options: Any) -> Barrier:
    options = {"distance_m": 0.8, "rate_1_s": 4.0, "acceleration_max_m_s2": 3.0} | options
    return kind(kind.Options(**options), scenario, Wishes(np.zeros((scenario.uavs, 2)), scenario))


def admit(made: Barrier, own: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """With everybody known exactly."""
    everyone = np.repeat(own[None], len(own), axis=0)
    return made.admit(own, everyone, np.arange(len(own)), wanted)


def swarm(uavs: int, spread: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    own = draw.normal(size=(uavs, 4)) * [spread, spread, 1.0, 1.0]
    return own, draw.normal(size=(uavs, 2))


@pytest.mark.parametrize("seed", range(20))
def test_together_every_pair_keeps_the_barrier_s_condition(seed: int) -> None:
    """ḧ + 2kḣ + k²h ≥ 0 of the motion, drag and wind included, wherever nobody's program was infeasible."""
    scenario = Scenario(uavs=8, wind=AIR, filter=Filter(kind="ecbf"))
    own, wanted = swarm(8, 3.0, seed)
    acceleration, infeasible = admit(filtered(scenario, reach_m=1e3, acceleration_max_m_s2=40.0), own, wanted)
    assert not infeasible.any()
    motion = acceleration - AIR.drag * (own[:, 2:] - AIR.mean)
    checked = 0
    for i in range(8):
        for j in range(i):
            apart, closing, pull = own[i, :2] - own[j, :2], own[i, 2:] - own[j, 2:], motion[i] - motion[j]
            h, first = apart @ apart - 0.8**2, 2.0 * apart @ closing
            second = 2.0 * closing @ closing + 2.0 * apart @ pull
            assert second + 8.0 * first + 16.0 * h >= -1e-6 * (1.0 + abs(first))
            checked += 1
    assert checked == 28
    assert (np.linalg.norm(motion, axis=1) <= 40.0 + 1e-9).all()


def stopping(distance: float, deceleration: float, dt: float) -> float:
    """Speed from which one stops within a distance, if braking begins one tick later, by the quadratic formula."""
    return float(np.roots([0.5 / deceleration, dt, -distance]).max())


@pytest.mark.parametrize("seed", range(20))
def test_together_every_pair_keeps_the_condition_of_the_braking_distance(seed: int) -> None:
    """ḣ + kh ≥ 0 with h = v_stop(d − D) + ḋ; the derivative of v_stop is a difference quotient here."""
    scenario = Scenario(uavs=6, wind=AIR, filter=Filter(kind="braking"))
    own, wanted = swarm(6, 5.0, seed)
    acceleration, infeasible = admit(filtered(scenario, Braking, reach_m=1e3, acceleration_max_m_s2=40.0), own, wanted)
    assert not infeasible.any()
    motion = acceleration - AIR.drag * (own[:, 2:] - AIR.mean)
    checked = 0
    for i in range(6):
        for j in range(i):
            apart, closing, pull = own[i, :2] - own[j, :2], own[i, 2:] - own[j, 2:], motion[i] - motion[j]
            distance = np.linalg.norm(apart)
            if (margin := distance - Braking.Options().distance_m) < 0.01:
                continue
            away = apart / distance
            first = away @ closing
            second = away @ pull + (closing @ closing - first**2) / distance
            h = stopping(margin, 80.0, 0.1) + first
            slope = (stopping(margin + 1e-6, 80.0, 0.1) - stopping(margin - 1e-6, 80.0, 0.1)) / 2e-6
            rate = Braking.Options().rate_1_s
            assert slope * first + second + rate * h >= -1e-4 * (1.0 + abs(slope * first))
            checked += 1
    assert checked >= 12


@pytest.mark.parametrize("kind", [Ecbf, Braking])
@pytest.mark.parametrize("seed", range(5))
def test_the_admitted_motion_is_that_of_a_solver_of_quadratic_programs(kind: type[Barrier], seed: int) -> None:
    scenario = Scenario(uavs=5, wind=Wind(drag=0.0))
    own, wanted = swarm(5, 4.0, seed)
    made = filtered(scenario, kind, acceleration_max_m_s2=1e3)
    acceleration, infeasible = admit(made, own, wanted)
    everyone = np.repeat(own[None], 5, axis=0)
    near = closest(own, everyone, np.arange(5), made.options.reach_m, 10)
    normals, bounds = made.half_planes(near, made.options.rate_1_s, made.options.distance_m, 0.5)
    assert not infeasible.any()
    for row in range(5):
        rows, least = normals[row][near.there[row]], bounds[row][near.there[row]]
        most = np.full(len(rows), 1e30)
        found, _, status, _ = daqp.solve(
            np.eye(2), -wanted[row], np.ascontiguousarray(rows), most, least, primal_tol=1e-12
        )
        assert status == 1
        np.testing.assert_allclose(acceleration[row], found, atol=1e-6)


@pytest.mark.parametrize("speed", [1.0, 2.25, 4.0])
def test_two_head_on_brake_within_the_limit_and_stop_at_the_distance(speed: float) -> None:
    """With the sampled-data margin neither is ever infeasible, and neither asks for more than the limit."""
    scenario = load(None, ["uavs=2", "wind.drag=0", "vehicle.acceleration_max=2"])
    made = filtered(scenario, Braking, distance_m=0.8, reach_m=30.0)
    own = np.array([[-10.0, 0.0, speed, 0.0], [10.0, 0.0, -speed, 0.0]])
    nearest, hardest = np.inf, 0.0
    for _ in range(200):
        acceleration, infeasible = admit(made, own, 2.0 * (np.array([[speed, 0.0], [-speed, 0.0]]) - own[:, 2:]))
        assert not infeasible.any()
        hardest = max(hardest, float(np.linalg.norm(acceleration, axis=1).max()))
        own = np.concatenate([own[:, :2] + 0.1 * own[:, 2:], own[:, 2:] + 0.1 * acceleration], axis=1)
        nearest = min(nearest, float(own[1, 0] - own[0, 0]))
    assert hardest <= 2.0 + 1e-9
    assert 0.78 <= nearest < 1.0


def test_what_nobody_is_in_the_way_of_passes_to_the_bit() -> None:
    scenario = Scenario(uavs=5, wind=AIR, filter=Filter(kind="ecbf"))
    own, wanted = swarm(5, 500.0, 1)
    acceleration, infeasible = admit(filtered(scenario, acceleration_max_m_s2=50.0), own, wanted)
    assert acceleration.tobytes() == wanted.tobytes()
    assert not infeasible.any()


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_what_a_controller_commands_may_lie_in_memory_as_it_likes(order: Any, dtype: Any) -> None:
    own, wanted = swarm(5, 1.0, 2)
    wanted = wanted.astype(np.float32)
    made = filtered(Scenario(uavs=5, filter=Filter(kind="ecbf")))
    expected, _ = admit(made, own, wanted.astype(np.float64))
    given = np.array(wanted, order=order, dtype=dtype)
    np.testing.assert_allclose(admit(made, own, given)[0], expected, rtol=1e-6)


def test_a_motion_beyond_the_limit_is_limited_and_keeps_its_direction() -> None:
    scenario = Scenario(uavs=1, wind=AIR, filter=Filter(kind="ecbf"))
    own, wanted = np.array([[50.0, 0.0, 1.0, 1.0]]), np.array([[30.0, -40.0]])
    acceleration, infeasible = admit(filtered(scenario), own, wanted)
    air = AIR.drag * (own[:, 2:] - AIR.mean)
    motion = wanted - air
    np.testing.assert_allclose(acceleration - air, 3.0 * motion / np.linalg.norm(motion), rtol=1e-12)
    assert infeasible.tolist() == [[0.0]]


def test_a_wish_that_is_no_number_stays_none_and_others_fly_on() -> None:
    own, wanted = swarm(3, 2.0, 1)
    wanted[1] = np.nan
    acceleration, _ = admit(filtered(Scenario(uavs=3, filter=Filter(kind="ecbf"))), own, wanted)
    assert np.isnan(acceleration).all(axis=1).tolist() == [False, True, False]


def test_two_in_one_place_part_to_either_side() -> None:
    """No direction leads apart, so it is x: the lower number to the left. Both are infeasible, and say so."""
    own = np.zeros((2, 4))
    acceleration, infeasible = admit(filtered(Scenario(uavs=2, wind=Wind(drag=0.0))), own, np.zeros((2, 2)))
    np.testing.assert_allclose(acceleration, [[-3.0, 0.0], [3.0, 0.0]], atol=1e-3)
    assert infeasible.tolist() == [[1.0], [1.0]]


def test_who_is_boxed_in_gives_up_the_least() -> None:
    """One between two walls of UAVs that close in: it cannot please both, and stands in the middle."""
    own = np.array([[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, -4.0, 0.0], [-0.5, 0.0, 4.0, 0.0]])
    made = filtered(Scenario(uavs=3, wind=Wind(drag=0.0)))
    acceleration, infeasible = admit(made, own, np.array([[2.0, 0.5], [0.0, 0.0], [0.0, 0.0]]))
    np.testing.assert_allclose(acceleration[0], [0.0, 0.5], atol=1e-6)
    assert infeasible[0, 0] == 1.0


def test_the_closest_are_the_closest_ties_by_number_and_no_more() -> None:
    others = np.zeros((1, 6, 4))
    others[0, :, 0] = [0.0, 3.0, 1.0, -1.0, 7.0, 2.0]
    near = closest(others[:, 0], others, np.array([0]), reach_m=5.0, most=3)
    assert near.away[0, :, 0].tolist() == [-1.0, 1.0, -2.0]
    assert near.there.all()
    assert closest(others[:, 0], others[:, :1], np.array([0]), 5.0, 3).away.shape == (1, 0, 2)  # alone
    discs, radii = closest_discs(others[:, 0], np.array([[9.0, 0.0, 5.0], [5.0, 0.0, 0.5], [99.0, 0.0, 1.0]]), 4.5, 4)
    assert radii.tolist() == [[5.0, 0.5]]
    assert discs.there.tolist() == [[True, True]]


# -- what the radio says of others ---------------------------------------------------------------------------------


def flown(scenario: Scenario, own: np.ndarray, heard: list[Received], at: int, until: int) -> tuple[Barrier, Step]:
    """A row 0 that hovers in `own` from tick 0 on, and hears something in a tick."""
    made, plan = filtered(scenario), np.zeros((scenario.uavs, 4))
    plan[:, 0] = 500.0 + 50.0 * np.arange(scenario.uavs)
    plan[0] = own
    made.inner.wanted = np.zeros((1, 2))  # type: ignore[attr-defined]
    memory = made.init(np.array([0]), plan)
    for tick in range(until + 1):
        step = made.step(memory, tick, own[None], heard if tick == at else ())
        memory = step.memory
    return made, step


def said(source: int, x: float, y: float = 0.0, vx: float = 0.0, vy: float = 0.0) -> list[Received]:
    payload = np.array([[x, y, vx, vy]])
    return [Received(0, np.array([source]), payload, np.array([[0, 0]]))]


OWN = np.array([40.0, 0.0, 0.0, 0.0])
EVERY_TICK = Scenario(
    uavs=3, wind=Wind(drag=0.0), filter=Filter(kind="ecbf"), sharing=Sharing(policy="tick", forget_s=2.0)
)


def test_who_is_heard_is_kept_off_and_who_is_silent_for_long_is_forgotten() -> None:
    near = said(1, 40.5)
    assert flown(EVERY_TICK, OWN, near, 3, 3)[1].acceleration[0, 0] < -0.5
    assert flown(EVERY_TICK, OWN, near, 3, 22)[1].acceleration[0, 0] < -0.5
    assert flown(EVERY_TICK, OWN, near, 3, 23)[1].acceleration.tolist() == [[0.0, 0.0]]


def test_a_liar_costs_no_more_than_the_limit_and_a_state_that_cannot_be_is_counted() -> None:
    step = flown(EVERY_TICK, OWN, said(1, 38.9, 0.0, 3.0), 3, 3)[1]
    assert 0.0 < np.linalg.norm(step.acceleration) <= 3.0 + 1e-9
    assert step.diagnostics is not None
    assert step.diagnostics[0, 0] == 1.0  # nothing can be done about it, and it is said
    step = flown(EVERY_TICK, OWN, said(1, 1e30), 3, 3)[1]
    assert step.acceleration.tolist() == [[0.0, 0.0]]
    assert step.refused.tolist() == [1]


def test_alone_in_the_world_nothing_is_changed() -> None:
    scenario = msgspec.structs.replace(EVERY_TICK, uavs=1)
    assert flown(scenario, OWN, [], 0, 2)[1].acceleration.tolist() == [[0.0, 0.0]]
    run = mf.fly(scenario_files.load(None, ["uavs=1", "duration=5", "filter.kind=ecbf"], method="cruise"))
    assert run.summary["collisions"] == 0


# -- flights ------------------------------------------------------------------------------------------------------


def test_a_start_that_already_collides_is_flown_apart_and_the_infeasible_ticks_are_counted() -> None:
    settings = ["uavs=9", "start.spacing=0.05", "duration=10", "wind.sigma=0"]
    summary = mf.fly(load(None, [*settings, "filter.kind=ecbf"], method="cruise")).summary
    assert summary["diagnostics"]["infeasible"] > 0
    assert summary["collisions"] > 0  # those of the start
    run = mf.fly(load(None, [*settings, "filter.kind=ecbf"], method="cruise"))
    last = run.states[-1, :, :2]
    apart = np.linalg.norm(last[:, None] - last, axis=-1)[np.triu_indices(9, 1)]
    assert apart.min() > 0.4


@pytest.mark.parametrize("seed", [1, 2])
def test_discs_are_gone_round(seed: int) -> None:
    """Without the filter the line to the destination leads through them."""
    discs = (Obstacle(centre=(75.0, 50.3), radius=3.0), Obstacle(centre=(40.0, 26.0), radius=2.0))
    of = Scenario(
        method="cruise", uavs=9, seed=seed, duration=120.0, obstacles=discs, start=Start(), destination=Destination()
    )

    def inside(scenario: Scenario) -> int:
        states = mf.fly(scenario).states
        return sum(
            int((np.linalg.norm(states[:, :, :2] - disc.centre, axis=-1) < disc.radius).any(axis=0).sum())
            for disc in discs
        )

    assert inside(of) > 4
    assert inside(msgspec.structs.replace(of, filter=Filter(kind="ecbf"))) == 0
