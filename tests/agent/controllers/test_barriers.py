"""The filters of control barrier functions: the conditions of the source, and commands where these cannot be met."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.barriers import Barrier, Braking, Ecbf
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.swarm.scenario import Filter, Scenario, Wind, load

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


def exponential(distance: float, first: float, second: float) -> float:
    """ḧ + 2kḣ + k²h of h = d² − D²."""
    rate = 2.0 * distance * first
    curvature = 2.0 * (first**2 + distance * second)
    return (curvature + 8.0 * rate + 16.0 * (distance**2 - 0.8**2)) / (1.0 + abs(rate))


def braking(distance: float, first: float, second: float, reaction_s: float = 0.0) -> float:
    """ḣ + kh of h = v_stop(d − D) + ḋ, the derivative of v_stop being a difference quotient."""

    def stop(way: float) -> float:  # speed from which a pair stops within a way, a tick and the reaction time later
        return float(np.roots([0.5 / 80.0, 0.1 + reaction_s, -way]).max())

    way = distance - 0.8
    slope = (stop(way + 1e-6) - stop(way - 1e-6)) / 2e-6
    return (slope * first + second + 4.0 * (stop(way) + first)) / (1.0 + abs(slope * first))


@pytest.mark.parametrize(
    ("kind", "condition", "options"),
    [
        (Ecbf, exponential, {}),
        (Braking, braking, {}),
        (Braking, partial(braking, reaction_s=0.4), {"reaction_s": 0.4}),
    ],
    ids=["ecbf", "braking", "braking-reaction"],
)
@pytest.mark.parametrize("seed", range(20))
def test_together_every_pair_keeps_the_condition_of_its_barrier(
    kind: type[Barrier], condition: Callable[[float, float, float], float], options: dict[str, float], seed: int
) -> None:
    """Of the motion, drag and wind included, if no UAV's program was infeasible."""
    scenario = Scenario(uavs=8, wind=AIR, filter=Filter(kind=kind.name))
    own, wanted = swarm(8, 3.0, seed)
    wanted *= 5.0  # so that conditions act
    made = filtered(scenario, kind, reach_m=1e3, acceleration_max_m_s2=40.0, **options)
    acceleration, infeasible = admit(made, own, wanted)
    assert not infeasible.any()
    motion = acceleration - AIR.drag * (own[:, 2:] - AIR.mean)
    assert (np.linalg.norm(motion, axis=1) <= 40.0 + 1e-9).all()
    checked = 0
    for i, j in zip(*np.triu_indices(8, 1), strict=True):
        apart, closing, pull = own[i, :2] - own[j, :2], own[i, 2:] - own[j, 2:], motion[i] - motion[j]
        distance = float(np.linalg.norm(apart))
        if distance < 0.81:
            continue
        first = apart @ closing / distance
        second = (apart @ pull + closing @ closing - first**2) / distance  # d''
        assert condition(distance, first, second) >= -1e-4
        checked += 1
    assert checked >= 20


@pytest.mark.parametrize("reaction_s", [0.0, 0.5])
@pytest.mark.parametrize("speed", [1.0, 2.25, 4.0])
def test_two_uavs_head_on_brake_within_the_limit_and_stop_at_the_distance(speed: float, reaction_s: float) -> None:
    """With the sampled-data margin neither is ever infeasible, and neither asks for more than the limit. Before them is
    always the braking distance v·t + v²/2a of their closing speed, where the pair brakes with a = 2 · 2 m/s²."""
    scenario = load(None, ["uavs=2", "wind.drag=0", "vehicle.acceleration_max=2"])
    made = filtered(scenario, Braking, distance_m=0.8, reach_m=30.0, reaction_s=reaction_s)
    own = np.array([[-10.0, 0.0, speed, 0.0], [10.0, 0.0, -speed, 0.0]])
    nearest, hardest = np.inf, 0.0
    for _ in range(200):
        acceleration, infeasible = admit(made, own, 2.0 * (np.array([[speed, 0.0], [-speed, 0.0]]) - own[:, 2:]))
        assert not infeasible.any()
        hardest = max(hardest, float(np.linalg.norm(acceleration, axis=1).max()))
        own = np.concatenate([own[:, :2] + 0.1 * own[:, 2:], own[:, 2:] + 0.1 * acceleration], axis=1)
        nearest = min(nearest, float(own[1, 0] - own[0, 0]))
        closing = float(own[0, 2] - own[1, 2])
        assert closing * reaction_s + closing**2 / 8.0 <= own[1, 0] - own[0, 0] - 0.8 + 0.03
    assert hardest <= 2.0 + 1e-9
    assert 0.78 <= nearest < 1.0


def test_a_command_passes_to_the_bit_if_no_uav_is_near() -> None:
    scenario = Scenario(uavs=5, wind=AIR, filter=Filter(kind="ecbf"))
    own, wanted = swarm(5, 500.0, 1)
    for given in (wanted, np.asfortranarray(wanted, np.float32)):
        acceleration, infeasible = admit(filtered(scenario, acceleration_max_m_s2=50.0), own, given)
        np.testing.assert_array_equal(acceleration, given)
        assert not infeasible.any()


def test_a_start_that_already_collides_is_flown_apart_and_counted() -> None:
    run = mf.fly("paper", method="cruise", uavs=9, duration=10, **{"start.spacing": 0.05, "filter.kind": "ecbf"})
    assert run.summary["diagnostics"]["infeasible"] > 0
    assert run.summary["collisions"] > 0  # those of the start
    last = run.states[-1, :, :2]
    apart = np.linalg.norm(last[:, None] - last, axis=-1)[np.triu_indices(9, 1)]
    assert apart.min() > 0.4
