"""Filters: all of the controller passes through unchanged; barriers keep their conditions, or say that they cannot."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

import meanflock as mf
from meanflock.agent.controllers.barriers import Barrier, Braking, Ecbf
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.swarm import declared, plugins
from meanflock.swarm.scenario import Filter, Scenario, Sharing, Wind, load
from meanflock.testing.trial import PointSwarm
from tests.testing.good import GoodController

SMALL = Scenario(uavs=6, filter=Filter(kind="ecbf"), sharing=Sharing(policy="event", delta_m=0.05, repeats=2))


class Open(plugins.load("filter", "ecbf")):
    """Changes nothing; the base of the wrong filters."""

    name = "open"
    columns = ("touched",)

    def admit(self, own: np.ndarray, others: np.ndarray, uavs: np.ndarray, wanted: np.ndarray) -> Any:
        return wanted, np.zeros((len(own), 1))


class Talker(GoodController):
    """Hears each broadcast by its number, and reports what it heard."""

    weights = 1
    period_ticks = 7
    broadcast_numbers = 5

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        told = [replace(frames, payload=(1.0 + frames.number) * frames.payload) for frames in received]
        return super().step(memory, tick, own, told)

    def report(self, memory: Memory) -> np.ndarray:
        return memory["heard"][:, None]


def talker() -> Controller:
    return Talker(Talker.Options(), SMALL)


def behind(filter_: Any, **options: Any) -> Any:
    return filter_(Ecbf.Options(**options), SMALL, talker())


def test_behind_a_filter_that_changes_nothing_a_controller_declares_flies_and_learns_as_alone() -> None:
    said = declared.declarations_of(behind(Ecbf), "good")
    assert (said.parameters, said.weights, said.period_ticks, said.broadcast_numbers) == (3, 1, 7, 5 + 4)
    assert said.diagnostics == ("heard", "infeasible", "unsent")
    bare, filtered = (PointSwarm(Talker, SMALL, make) for make in (talker, lambda: behind(Open)))
    alone, other = bare.trial(), filtered.trial()
    for mine, theirs in zip(alone.commands, other.commands, strict=True):
        np.testing.assert_array_equal(mine, theirs[:, :3])
    for sent, also in zip(alone.broadcasts, other.broadcasts, strict=True):
        assert also[0][1].dtype == np.int16  # an event of the filter
        for one, its in zip(sent, also[1:], strict=True):
            assert [part.tobytes() for part in one] == [part.tobytes() for part in its]
    assert alone.models.tobytes() == other.models.tobytes()
    made, rows, models = behind(Open), np.array([1]), np.array([[5.0, 6.0, 7.0]])
    taught = made.set(other.memory, rows, models)
    np.testing.assert_array_equal(made.get(taught), talker().get(talker().set(alone.memory, rows, models)))
    np.testing.assert_array_equal(made.report(taught), alone.memory["heard"][:, None])
    assert set(taught) == set(other.memory)


def test_names_of_the_filter_are_refused_in_the_memory_of_the_controller_and_in_columns() -> None:
    class Clash(GoodController):
        def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
            return {"filter_mine": np.zeros(len(uavs))}

    with pytest.raises(ValueError, match=r"'filter_mine'.*those of the filter"):
        Ecbf(Ecbf.Options(), SMALL, Clash(Clash.Options(), SMALL)).init(np.arange(6), np.zeros((6, 4)))
    for columns, expected in (("near", "write"), (("near", "near"), "different"), (("unsent",), "unsent")):
        with pytest.raises((TypeError, ValueError), match=expected):
            type("Wrong", (Open,), {"columns": columns})(Ecbf.Options(), SMALL, talker())


@pytest.mark.parametrize(
    ("admit", "text"),
    [
        (lambda *_: 1 / 0, r"filter 'open': ZeroDivisionError: division by zero \(test_filtered.py, line \d+\)"),
        (lambda _, own, *__: (own, own[:, :1]), r"filter 'open': .* accelerations \(6, 4\); expected \(6, 2\)"),
        (lambda *given: (given[-1], None), r"filter 'open': `admit` returns columns \(\); expected \(6, 1\)"),
    ],
)
def test_an_error_of_a_filter_names_the_filter_and_not_the_controller(admit: Any, text: str) -> None:
    made: Any = type("Wrong", (Open,), {"admit": admit})(Ecbf.Options(), SMALL, talker())
    with pytest.raises((RuntimeError, ValueError), match=text):
        made.step(made.init(np.arange(6), np.zeros((6, 4))), 0, np.zeros((6, 4)), ())


AIR = Wind(drag=0.3, mean=(3.0, -2.0))


def filtered(scenario: Scenario, kind: type[Barrier] = Ecbf, **options: Any) -> Barrier:
    options = {"distance_m": 0.8, "rate_1_s": 4.0, "acceleration_max_m_s2": 3.0} | options
    return kind(kind.Options(**options), scenario, GoodController(None, scenario))


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
