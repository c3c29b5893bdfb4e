"""Sharing of states: when controllers and filters send them and how they fly by them; what barriers keep."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

import meanflock as mf
from meanflock.agent.controllers.barriers import Braking, Ecbf, HalfPlaneFilter
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.controllers.sharing.base import NeighbourStates
from meanflock.swarm import declared, mission, plugins
from meanflock.swarm.scenario import FilterTable, Scenario, Wind, load
from meanflock.swarm.scenario.tables import POLICIES, Sharing
from meanflock.testing.trial import PointSwarm
from tests.agent.controllers.by_hand import made, stepped
from tests.testing.good import GoodController

METHODS = ("vasarhelyi", "olfati-saber", "potential-field", "orca", "bvc")
BEHIND = {kind: ("cruise", f"filter.kind={kind}") for kind in ("ecbf", "braking")}
SUBJECTS: dict[str, tuple[str, ...]] = {**{method: (method,) for method in METHODS}, **BEHIND}
STATES = np.array([[70.0, 0.0, 0, 0], [71.0, 0.0, 0, 0], [70.0, 30.0, 0, 0]])
each = pytest.mark.parametrize("subject", SUBJECTS.values(), ids=SUBJECTS)


@each
def test_a_received_state_moves_its_receiver_and_a_false_one_is_named_and_not_used(subject: tuple[str, ...]) -> None:
    controller = made(*subject, "sharing.policy=tick", "sharing.forget_s=2", uavs=3)
    memory = controller.init(np.arange(3), STATES)
    said = [[70.3, 0.4, 0, 0], [70.3, 0.4, 300, 0], [1e30, 0, 0, 0]]
    true, *false = (Received(0, np.array([2]), np.array([state]), np.array([[0, 0]])) for state in said)
    heard = ([], [true], *([one] for one in false))
    alone, pushed, *fooled = (controller.step(memory, 1, STATES, received) for received in heard)
    assert np.hypot(*(pushed.acceleration - alone.acceleration)[0]) > 0.01
    assert pushed.acceleration[1:].tobytes() == alone.acceleration[1:].tobytes()
    assert not len(pushed.refused)
    for step in fooled:
        assert step.acceleration.tobytes() == alone.acceleration.tobytes()
        assert step.refused.tolist() == [2]
    later = [controller.step(pushed.memory, tick, STATES, ()).acceleration for tick in (19, 23)]
    assert np.hypot(*(later[0] - later[1])[0]) > 0.01  # a UAV that was not received for long is not avoided


@each
def test_a_state_beyond_16_bits_is_not_sent_and_counted(subject: tuple[str, ...]) -> None:
    controller = made(*subject, uavs=3)
    memory = controller.init(np.arange(3), STATES)
    halfway = 0.5 * mission.starts(controller.scenario)[:, :1]
    far = np.concatenate([halfway + np.array([[327.6], [327.8], [-327.8]]), np.zeros((3, 3))], axis=1)
    fast = STATES + np.array([0, 0, 0, 400.0])
    for moved, sent, counted in ((far, [0], [0.0, 1.0, 1.0]), (fast, [], [1.0, 1.0, 1.0])):
        step = controller.step(memory, 1, moved, ())
        assert step.diagnostics[:, -1].tolist() == counted
        assert step.broadcasts[0].rows.tolist() == sent
    assert not controller.step(step.memory, 2, STATES, ()).diagnostics[:, -1].any()


@each
def test_two_uavs_in_one_place_come_apart(subject: tuple[str, ...]) -> None:
    step = stepped(made(*subject), np.array([[70.0, 0.0, 0, 0], [70.0, 0.0, 0, 0]]))
    assert np.isfinite(step.acceleration).all()
    if subject != ("olfati-saber",):  # whose force vanishes there
        assert step.acceleration[0, 0] < step.acceleration[1, 0] - 1.0


@pytest.mark.parametrize(("method", "mean_s"), [("vasarhelyi", 82.0), ("olfati-saber", 110.0), ("orca", 82.0)])
def test_the_swarm_arrives_without_a_collision_and_events_take_a_tenth_of_the_bits(method: str, mean_s: float) -> None:
    runs = [
        mf.fly("paper", method=method, seed=4, **{"sharing.policy": policy}).summary for policy in ("tick", "event")
    ]
    for summary in runs:
        assert (summary["collisions_all"], summary["arrived"]) == (0, 25)
        assert summary["t_avg_s"] < mean_s
    every_tick, events = (summary["payload_bits"]["state"] for summary in runs)
    assert events < 0.1 * every_tick


@pytest.mark.parametrize(("method", "limit"), [("orca", None), ("bvc", 6.0)])
def test_a_swap_through_one_point_ends_without_a_collision_and_needs_a_rule_of_the_road(
    method: str, limit: float | None
) -> None:
    swap = {"uavs": 16, "start.radius": 10.0, "vehicle.acceleration_max": limit, "duration": 60}
    run = mf.fly("swap", method=method, seed=5, **swap).summary
    assert (run["collisions_all"], run["arrived"], run["lost"]) == (0, 16, 0)
    without = mf.fly("swap", method=method, seed=5, **swap, **{"controller.right_bias": 0.0}).summary
    assert without["t_max_s"] is None or without["t_max_s"] > run["t_max_s"]


@pytest.mark.parametrize(("subject", "hits"), [*((subject, 0) for subject in SUBJECTS), ("cruise", 2)])
def test_a_uav_alone_arrives_round_discs_that_lie_in_its_way(subject: str, hits: int) -> None:
    discs = [{"centre": [75.0, 50.3], "radius": 3.0}, {"centre": [40.0, 26.0], "radius": 2.0}]
    method = {"method": "cruise", "filter.kind": subject} if subject in BEHIND else {"method": subject}
    summary = mf.fly("paper", uavs=1, seed=1, obstacles=discs, duration=120, **method).summary
    assert (summary["obstacle_hits"], summary["arrived"]) == (hits, 1)
    assert summary["radio"]["traffic"]["state"]["sent"] == 0


N = 5
EVENT = Sharing(policy="event")
UAVS = np.arange(N)


def neighbours(sharing: Sharing) -> NeighbourStates:
    return NeighbourStates(replace(load(None, [f"uavs={N}"]), sharing=sharing))


def plan(seed: int = 0) -> np.ndarray:
    draw = np.random.default_rng(seed)
    return np.concatenate([draw.normal(0, 10, (N, 2)), draw.normal(0, 1, (N, 2))], axis=1)


def test_a_state_is_sent_when_others_predict_its_position_too_badly() -> None:
    table = neighbours(EVENT)
    memory = table.init(UAVS, plan())
    now = table.states(memory, 10)[0].copy()
    now[1, 0] += 0.29
    now[2, :2] += (-0.2, 0.25)  # 0.32 m
    now[3, 2:] += (0.2, -0.25)  # a velocity alone is an event only where one is asked for
    now[4, 2:] += (0.2, -0.2)  # 0.28 m/s
    after, broadcast = table.broadcast_states(memory, 10, now)
    assert broadcast.rows.tolist() == [2]
    assert broadcast.payload.dtype == np.int16
    assert broadcast.payload.shape == (1, 4)
    heard = Received(0, UAVS[2:3], broadcast.payload, np.array([[0, row] for row in range(N) if row != 2]))
    predicted = table.states(table.receive(after, 11, [heard])[0], 11)
    expected = now[2].copy()
    expected[:2] += 0.1 * now[2, 2:]
    np.testing.assert_allclose(predicted[:, 2], np.repeat(expected[None], N, axis=0), rtol=0, atol=0.0056)
    also = neighbours(Sharing(policy="event", velocity_delta_m_s=0.3))
    assert also.broadcast_states(also.init(UAVS, plan()), 10, now)[1].rows.tolist() == [2, 3]
    again, broadcast = table.broadcast_states(
        after, 11, np.where(UAVS[:, None] == 2, expected, table.states(after, 11)[0])
    )
    assert not len(broadcast.payload)
    assert again["neighbour_remembered"].tobytes() == after["neighbour_remembered"].tobytes()


@pytest.mark.parametrize(
    "payload",
    [np.ones((1, 4), np.float64), np.ones((1, 3), np.int16), np.ones((1, 4), np.int32), np.ones((1, 5), np.int16)],
)
def test_a_payload_of_another_type_or_width_is_no_state(payload: np.ndarray) -> None:
    table = neighbours(EVENT)
    memory = table.init(UAVS[:2], plan())
    after, _ = table.receive(memory, 1, [Received(0, UAVS[2:3], payload, np.array([[0, 0]]))])
    assert after["neighbour_remembered"] is memory["neighbour_remembered"]
    right = Received(1, UAVS[2:3], np.ones((1, 4), np.int16), np.array([[0, 0]]))
    assert table.receive(memory, 1, [right])[0]["neighbour_tick"] is memory["neighbour_tick"]
    assert (table.receive(memory, 3, [right], number=1)[0]["neighbour_tick"] == [[0, 0, 2, 0, 0], [0] * 5]).all()


def test_a_key_of_the_table_changes_one_part_of_its_policy() -> None:
    assert Sharing().rule == POLICIES["event-4"] == ("event", 0.3, 0.2, 4)
    assert Sharing(policy="event").rule == ("event", 0.3, 0.0, 1)
    assert Sharing(policy="tick").rule.broadcast == "tick"
    assert Sharing(policy="event", delta_m=0.1, repeats=2).rule == ("event", 0.1, 0.0, 2)
    assert Sharing(velocity_delta_m_s=0.0).rule == ("event", 0.3, 0.0, 4)


# -- filters ------------------------------------------------------------------------------------------------------

SMALL = Scenario(uavs=6, filter=FilterTable(kind="ecbf"), sharing=Sharing(policy="event", delta_m=0.05, repeats=2))


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
        with pytest.raises(mf.BadInput, match=rf"`columns` .*{expected}"):
            type("Wrong", (Open,), {"columns": columns})(Ecbf.Options(), SMALL, talker())


@pytest.mark.parametrize(
    ("admit", "text"),
    [
        (lambda *_: 1 / 0, r"filter 'open': ZeroDivisionError: division by zero \(test_sharing.py, line \d+\)"),
        (lambda _, own, *__: (own, own[:, :1]), r"filter 'open': .* accelerations \(6, 4\); expected \(6, 2\)"),
        (lambda *given: (given[-1], None), r"filter 'open': `admit` returns columns \(\); expected \(6, 1\)"),
        (
            lambda *given: given[-1],
            "filter 'open': TypeError: `admit` returns a ndarray; expected the accelerations and th",
        ),
    ],
)
def test_an_error_of_a_filter_names_the_filter_and_not_the_controller(admit: Any, text: str) -> None:
    made: Any = type("Wrong", (Open,), {"admit": admit})(Ecbf.Options(), SMALL, talker())
    with pytest.raises((RuntimeError, ValueError), match=text):
        made.step(made.init(np.arange(6), np.zeros((6, 4))), 0, np.zeros((6, 4)), ())


AIR = Wind(drag=0.3, mean=(3.0, -2.0))


def filtered(scenario: Scenario, kind: type[HalfPlaneFilter] = Ecbf, **options: Any) -> HalfPlaneFilter:
    options = {"distance_m": 0.8, "rate_1_s": 4.0, "acceleration_max_m_s2": 3.0} | options
    return kind(kind.Options(**options), scenario, GoodController(None, scenario))


def admit(made: HalfPlaneFilter, own: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
    kind: type[HalfPlaneFilter], condition: Callable[[float, float, float], float], options: dict[str, float], seed: int
) -> None:
    """Of the motion, drag and wind included, if no UAV's program was infeasible."""
    scenario = Scenario(uavs=8, wind=AIR, filter=FilterTable(kind=kind.name))
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
    scenario = Scenario(uavs=5, wind=AIR, filter=FilterTable(kind="ecbf"))
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
