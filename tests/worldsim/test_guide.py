"""Goals that change in flight: waypoints, patrols, moving goals, and batteries. Their bits in all modes are golden."""

import re
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.control import encode_record
from meanflock.swarm.wire.messages import Sense
from meanflock.worldsim.crew import LocalCrew, fly
from meanflock.worldsim.world import World
from tests.agent.learning.lines import Line
from tests.sources import ROOT

SQUARE = [[12.0, 0.0], [12.0, 12.0], [0.0, 12.0], [0.0, 0.0]]
CALM: dict[str, Any] = {"uavs": 1, "wind": {"sigma": 0.0, "mean": [0.0, 0.0]}, "method": "cruise", "duration": 120.0}
AT_ORIGIN: dict[str, Any] = CALM | {"start": {"centre": [0.0, 0.0]}}
GUIDED = [
    (name, dimensions)
    for name in plugins.names("controller")
    for dimensions in plugins.load("controller", name).dimensions  # type: ignore[attr-defined]
    if plugins.load("controller", name).guided and name not in ("mfg", "mfgfl-f")  # type: ignore[attr-defined]  # twins
]
LEARNERS = ("hjb", "mfgfl-h", "mfgfl-hf")


def flown(scenario: Scenario) -> tuple[World, np.ndarray, list[str]]:
    """The world after a flight, positions (T, N, d), and texts of the events."""
    world = World(plan_of(scenario))
    places, texts = [world.flight.states[:, :2]], []
    for row in fly(world, LocalCrew(world)):
        places.append(row.states[:, :2])
        texts += [event.text for event in row.events]
    return world, np.array(places), texts


@pytest.mark.parametrize(("method", "dimensions"), GUIDED)
def test_a_guided_controller_flies_to_every_waypoint_in_turn(method: str, dimensions: int) -> None:
    waypoints, radius = (SQUARE[:3], 4.0) if method not in LEARNERS else ([[40.0, 100.0], [0.0, 0.0]], 8.0)
    own: dict[str, Any] = {"uavs": 1} if method in LEARNERS else AT_ORIGIN  # the learners need the wind
    keys = own | {"method": method, "duration": 600.0}
    destination = {"waypoints": waypoints, "radius": radius}
    world, places, _ = flown(Scenario(**keys, space={"dimensions": dimensions}, destination=destination))
    assert world.flight.guide.reached == len(waypoints)
    assert world.flight.arrival_tick[0] > 0
    nearest = np.linalg.norm(places[:, 0, None] - np.array(waypoints), axis=-1)
    assert nearest.min(axis=0).max() <= radius
    assert np.all(np.diff(nearest.argmin(axis=0)) > 0)


def test_the_page_says_which_controllers_are_guided() -> None:
    page = (ROOT / "docs" / "lasting-missions.md").read_text(encoding="utf-8")
    named = {
        row.split("|")[1].strip(): re.findall(r"`([\w-]+)`", row)
        for row in re.findall(r"\| (?:guided|refused).*", page)
    }
    guided = {name: plugins.load("controller", name).guided for name in plugins.names("controller")}  # type: ignore[attr-defined]
    assert named["guided"] == sorted(name for name in guided if guided[name])
    refused = sorted(name for row, names in named.items() if row != "guided" for name in names)
    assert refused == sorted(name for name in guided if not guided[name])
    for name in refused:
        with pytest.raises(mf.BadInput, match=f"controller '{name}' flies to one goal only"):
            plan_of(Scenario(method=name, destination={"waypoints": SQUARE}))


def test_a_filter_and_a_learner_pass_goals_on() -> None:
    keys = AT_ORIGIN | {"uavs": 2, "filter": {"kind": "ecbf"}, "training.learner": Line, "duration": 90.0}
    world, *_ = flown(Scenario(**keys, destination={"waypoints": SQUARE[:2], "radius": 5.0}))
    assert world.flight.guide.reached == 4


def test_a_patrol_goes_on_and_nobody_arrives() -> None:
    world, _, _ = flown(Scenario(**AT_ORIGIN, destination={"waypoints": SQUARE, "patrol": True, "radius": 4.0}))
    assert world.flight.guide.reached > len(SQUARE)
    assert (world.flight.arrival_tick == -1).all()


def test_a_moving_goal_is_where_its_times_say() -> None:
    destination = {"waypoints": [[0.0, 0.0], [30.0, 0.0], [30.0, 10.0]], "times_s": [0.0, 20.0, 30.0], "radius": 5.0}
    world, places, _ = flown(Scenario(**AT_ORIGIN, destination=destination))
    guide = World(world.plan).flight.guide
    for tick, goal in ((100, [15.0, 0.0]), (250, [30.0, 5.0]), (900, [30.0, 10.0])):
        guide.move(tick)
        np.testing.assert_allclose(guide.goals[0, :2], goal)
    assert np.linalg.norm(places[150, 0] - [22.5, 0.0]) < 8.0  # it follows
    assert world.flight.arrival_tick[0] >= 300
    around = Scenario(**AT_ORIGIN, destination=destination | {"patrol": True})
    again = World(plan_of(around)).flight.guide
    again.move(300 + 100)
    np.testing.assert_allclose(again.goals[0, :2], [15.0, 0.0])


def test_a_low_battery_sends_a_uav_to_the_nearest_landing_place() -> None:
    """Hovering at rest costs blade and induced power alone, so the time of turning back is known."""
    keys = AT_ORIGIN | {"stop": "duration", "destination": {"radius": 1.0}, "start": {"centre": [0.2, 0.0]}}
    scenario = Scenario(**keys, energy={"battery_J": 8.0, "landings": [[40.0, 0.0], [-9.0, 0.0]]})
    power = float(scenario.vehicle.power(np.zeros(1), np.zeros(1))[0])
    _, places, texts = flown(scenario)
    assert texts[-2:] == ["UAV 0 turned back: low battery", "UAV 0 landed: at a landing place, with a low battery"]
    assert np.linalg.norm(places[-1, 0] - [-9.0, 0.0]) <= 1.0
    turned = next(tick for tick, place in enumerate(places[:, 0]) if abs(place[0]) > 0.5)
    assert turned * scenario.dt == pytest.approx(0.8 * 8.0 / power, abs=2.5)
    summary = Engine(scenario, "battery").complete()
    assert (summary["turned_back"], summary["batteries_empty"], summary["landed"], summary["arrived"]) == (1, 0, 1, 1)
    assert summary["energy_end_mean_J"] < 8.0


@pytest.mark.parametrize(("empty", "fields"), [("lands", (1, 0)), ("falls", (0, 1))])
def test_an_empty_battery_lands_a_uav_where_it_is_or_lets_it_fall(empty: str, fields: tuple[int, int]) -> None:
    """The radio takes what the way home would need: the check before take-off counts motion alone."""
    keys = AT_ORIGIN | {"stop": "duration", "destination": {"radius": 0.5}}
    energy = {"battery_J": 4.0, "reserve": 0.4, "landings": [[-25.0, 0.0]], "empty": empty, "idle_W": 0.5}
    scenario = Scenario(**keys, energy=energy)
    summary = Engine(scenario, "empty").complete()
    assert (summary["landed"], summary["lost"]) == fields
    assert summary["batteries_empty"] == 1
    if empty == "lands":  # one that fell counts as one that flies on without commands
        assert 4.0 <= summary["energy_total_J"] < 5.0


WRONG_GOALS: list[tuple[str, dict[str, Any]]] = [
    ("not here", {"uavs": np.array([7]), "goals": np.zeros((1, 2))}),
    ("below 0", {"uavs": np.array([-1]), "goals": np.zeros((1, 2))}),
    ("one goal too few", {"uavs": np.array([0, 1]), "goals": np.zeros((1, 2))}),
    ("in space", {"uavs": np.array([0]), "goals": np.zeros((1, 3))}),
    ("integers", {"uavs": np.array([0]), "goals": np.zeros((1, 2), dtype=np.int64)}),
    ("nothing", {"goals": np.zeros((1, 2))}),
]


@pytest.mark.parametrize("record", [record for _, record in WRONG_GOALS], ids=[name for name, _ in WRONG_GOALS])
def test_goals_that_do_not_fit_a_node_are_refused_and_change_nothing(record: dict[str, Any]) -> None:
    crew = LocalCrew(World(plan_of(Scenario(**CALM | {"uavs": 2, "energy": {"battery_J": 300.0}}))))
    (agent,), states = crew.agents, np.zeros((2, 4))
    agent.act(Sense(0, 0, states))
    before = {name: array.copy() for name, array in agent._memory.items()}
    with pytest.raises(MessageRejected):
        agent.act(Sense(0, 1, states, memory=encode_record(record)))
    assert all((agent._memory[name] == array).all() for name, array in before.items())
    told = {"uavs": np.array([1]), "goals": np.array([[30.0, 40.0]])}
    agent.act(Sense(0, 1, states, memory=encode_record(told)))
    assert agent._memory["travel_end"].tolist() == [before["travel_end"][0].tolist(), [30.0, 40.0]]


TWO_VEHICLES: dict[str, Any] = {
    "uavs": 2,
    "energy": {"battery_J": 3.0},
    "space": {"dimensions": 3},
    "vehicle": {"model": "multirotor"},  # whose power is not foreseen
    "groups": [{"name": "a", "count": 1}, {"name": "b", "count": 1, "vehicle": {}}],
}
BAD: list[tuple[dict[str, Any], str]] = [
    ({"destination": {"patrol": True}}, "`destination.patrol` has no effect without `destination.waypoints`"),
    ({"destination": {"times_s": [0.0]}}, "`destination.times_s` has no effect without `destination.waypoints`"),
    ({"destination": {"waypoints": SQUARE[:1], "patrol": True}}, "needs two `destination.waypoints` or more"),
    ({"destination": {"waypoints": SQUARE[:2], "times_s": [0.0]}}, "must ascend from 0, one for each of the 2"),
    ({"destination": {"waypoints": SQUARE[:2], "times_s": [0.0, 0.0]}}, "must ascend from 0"),
    ({"destination": {"waypoints": SQUARE[:2], "times_s": [1.0, 2.0]}}, "must ascend from 0"),
    ({"destination": {"waypoints": SQUARE, "goals": "common"}}, "`destination.goals` are both given"),
    ({"destination": {"waypoints": [[0.0, 0.0, 1.0]]}}, "the flight is in the plane"),
    (
        {"destination": {"waypoints": SQUARE}, "method": "offline"},
        "'offline' flies to one goal only; leave that out, or",
    ),
    ({"energy": {"battery_J": 99.0}, "method": "plan"}, "`energy.battery_J` sends UAVs home"),
    ({"energy": {"reserve": 0.3}}, "`energy.reserve` has no effect without `energy.battery_J`"),
    ({"energy": {"battery_J": 0.0}}, "battery_J"),
    ({"energy": {"battery_J": 9.0, "landings": [[0.0, 0.0, 1.0]]}}, "leave the third out"),
    ({"energy": {"battery_J": 3.0}}, "leaves a reserve of 0.6 J"),
    (TWO_VEHICLES, "leaves a reserve of 0.6 J"),
    ({"groups": [{"name": "a", "count": 1, "destination": {"patrol": True}}]}, "`groups[0]`: `destination.patrol`"),
]


@pytest.mark.parametrize(("keys", "text"), BAD, ids=[text[:40] for _, text in BAD])
def test_missions_that_contradict_themselves_are_refused(keys: dict[str, Any], text: str) -> None:
    with pytest.raises(mf.BadInput, match=re.escape(text)):
        plan_of(Scenario(**CALM | keys))


@pytest.mark.parametrize(
    ("guide", "text"),
    [
        (mf.Controller.guide, "NotImplementedError: a controller that is `guided` must override `guide`"),
        (lambda *_: None, "TypeError: memory is a NoneType; expected a dict of arrays"),
    ],
)
def test_a_guided_controller_that_takes_no_goals_is_refused_before_take_off(guide: Any, text: str) -> None:
    still = {"step": lambda _, memory, tick, own, received: mf.Step(memory, 0.0 * own[:, :2])}
    plugins.register(type("Deaf", (mf.Controller,), {"name": "deaf", "guided": True, "guide": guide, **still}))
    with pytest.raises(mf.BadInput, match=f"controller 'deaf' failed in `guide` with UAV 0: {text}"):
        Engine(Scenario(**CALM | {"method": "deaf", "energy": {"battery_J": 1e6}}), "deaf")


def test_a_battery_is_judged_by_the_vehicle_of_each_group_and_its_way() -> None:
    near = {"name": "b", "count": 1, "vehicle": {}, "start": {"positions": [[1.0, 1.0]]}}
    plan = plan_of(Scenario(**CALM | TWO_VEHICLES | {"groups": [TWO_VEHICLES["groups"][0], near]}))
    assert [group.scenario.vehicle.model for group in plan.groups] == ["multirotor", "point-mass"]
    assert [other.vehicle.model for other in plan.groups[1].scenario.groups] == ["multirotor", "point-mass"]
