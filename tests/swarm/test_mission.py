"""A mission: places and times of starts, goals and obstacles; the missions that come with meanflock."""

import math
from pathlib import Path

import numpy as np
import pytest

from meanflock.channel.link import expected
from meanflock.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Gust
from meanflock.swarm.mission import goal_states, goals, launches, obstacles, starts
from meanflock.swarm.scenario import Scenario, load
from tests.methods import METHODS


@pytest.mark.parametrize("uavs", [1, 7, 25, 200])
def test_every_uav_starts_at_rest_on_its_own_place_of_a_centred_grid(uavs: int) -> None:
    states = starts(load(None, [f"uavs={uavs}"]))
    assert states.shape == (uavs, 4)
    assert not state.velocity(states).any()
    position = state.position(states)
    steps = (position - position[0]) / math.sqrt(2)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert len({tuple(row) for row in np.round(steps).tolist()}) == uavs
    width = math.ceil(math.sqrt(uavs))
    assert steps.max() <= width - 1 + 1e-9
    if width**2 == uavs:
        np.testing.assert_allclose(position.mean(axis=0), [150.0, 100.0], atol=1e-9)
    if uavs == 7:
        assert np.round(steps).tolist() == [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1], [0, 2]]


def test_a_circle_places_uavs_evenly_and_sends_each_to_the_other_side() -> None:
    circle = ["start.formation=circle", "start.radius=25.0", "start.centre=[3.0, 4.0]"]
    flown = load(None, ["uavs=6", *circle, "destination.goals=opposite"])
    from_centre = state.position(starts(flown)) - [3.0, 4.0]
    np.testing.assert_allclose(np.hypot(*from_centre.T), 25.0)
    angles = np.unwrap(np.arctan2(*from_centre.T[::-1]))
    np.testing.assert_allclose(np.diff(angles), math.pi / 3)
    np.testing.assert_allclose(goals(flown) - [3.0, 4.0], -from_centre, atol=1e-12)
    np.testing.assert_allclose(goals(flown), starts(flown)[[3, 4, 5, 0, 1, 2], :2], atol=1e-12)


def test_two_streams_cross_at_the_centre_and_keep_their_order() -> None:
    streams = ["start.formation=streams", "start.radius=35.0", "start.centre=[0.0, 0.0]"]
    flown = load(None, ["uavs=9", *streams, "destination.goals=across"])
    place, way = state.position(starts(flown)), goals(flown) - state.position(starts(flown))
    np.testing.assert_allclose(way[:5], [[70.0, 0.0]] * 5)
    np.testing.assert_allclose(way[5:], [[0.0, 70.0]] * 4)
    assert np.abs(place[:5].mean(axis=0) - [-35.0, 0.0]).max() < 2.0
    assert (np.hypot(*(place[:, None] - place[None]).T) + np.eye(9) * 99).min() == pytest.approx(math.sqrt(2))


def test_by_default_all_fly_to_the_origin_at_once_and_parallel_goals_are_the_formation_about_it() -> None:
    assert not goals(load(None)).any()
    parallel = load(None, ["destination.goals=parallel"])
    np.testing.assert_allclose(goals(parallel), starts(parallel)[:, :2] - [150.0, 100.0])
    assert not launches(load(None)).any()
    assert obstacles(load(None)).shape == (0, 3)


def test_waves_are_rows_that_leave_one_after_another() -> None:
    flown = load(None, ["uavs=7", "start.formation=waves", "start.group=3", "start.interval=4.04"])
    assert launches(flown).tolist() == [0, 0, 0, 40, 40, 40, 81]
    rows = starts(flown)[:, 1]
    assert rows[0] == rows[1] == rows[2] < rows[3] == rows[5] < rows[6]


def test_listed_places_and_goals_are_used() -> None:
    flown = load(None, ["uavs=2", "start.positions=[[1, 2], [3.5, -4]]", "destination.positions=[[0, 0], [9, 9]]"])
    assert starts(flown).tolist() == [[1, 2, 0, 0], [3.5, -4, 0, 0]]
    assert goal_states(flown).tolist() == [[0, 0, 0, 0], [9, 9, 0, 0]]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["uavs=2", "start.positions=[[1, 2]]"], r"`start.positions` has 1 places for 2 UAVs"),
        (["destination.positions=[[1, 2]]"], r"`destination.positions` has 1 places for 25 UAVs"),
        (["uavs=1", "start.positions=[[1, 2]]", "start.formation=grid"], "both given; leave one of them out"),
        (["uavs=2", "start.positions=[[1, 2], [1.05, 2]]"], "UAV 0 and UAV 1 start 0.05 m apart, nearer than"),
        (["uavs=100", "start.formation=circle", "start.radius=1"], "start 0.0628.* m apart"),
        (["duration=1.1e30"], r"`duration` must be a finite number within ±1e\+30, not 1.1e\+30"),
        (["start.centre=[1e300, 0]"], r"`centre` must be a finite number within ±1e\+30, not 1e\+300"),
        (["start.centre=[1e5, 0]", "radio.bits_per_float=16"], "`start` places a UAV 100003 m out.*65504"),
        (["destination.goals=across"], '"across" needs streams'),
        (["obstacles=[{centre=[1.0, 1.0], radius=2.0}]"], r"UAV 0 has its goal inside `obstacles\[0\]`"),
        (["obstacles=[{centre=[9, 9], radius=1}, {centre=[150, 100], radius=0.5}]"], "UAV 12 starts inside"),
    ],
)  # fmt: skip
def test_an_impossible_mission_is_refused_with_its_key(settings: list[str], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        load(None, settings)
    load(None, ["start.spacing=0.05"])  # near places are accepted in a narrow grid and in different waves
    load(None, ["uavs=2", "start.positions=[[1, 2], [1, 2]]", "start.group=1", "start.interval=3"])


@pytest.mark.parametrize("method", METHODS)
def test_a_controller_of_the_paper_flies_to_its_own_goal_as_to_the_origin(method: str) -> None:
    settings = ["uavs=4", "wind.sigma=0", "duration=5", "federation.state_period=7", f"method={method}"]
    moved = [f"destination.positions={[[64.0, -32.0]] * 4}", "start.centre=[214.0, 68.0]"]
    moved += [f"start.spacing={math.sqrt(2.0)}"]
    here, away = Engine(load(None, settings), "here"), Engine(load(None, settings + moved), "away")
    for _ in zip(here.fly(), away.fly(), strict=True):
        pass
    shift = [64.0, -32.0, 0.0, 0.0]
    np.testing.assert_allclose(away.world.flight.states - shift, here.world.flight.states, atol=1e-6)
    assert np.abs(here.world.flight.states[:, 2:]).max() > 0.1


def mission(name: str, **options: object) -> Scenario:
    return load(Path(name), **options)


@pytest.mark.parametrize("name", ["obstacles", "gusts", "crowd", "hierarchical"])  # the others are golden
def test_a_mission_flies_by_its_name(name: str) -> None:
    summary = Engine(mission(name, duration=2.0, method="cruise" if name != "hierarchical" else None), name).complete()
    assert summary["sim_time_s"] == pytest.approx(2.0)


def test_obstacles_gusts_waves_and_unknown_wind_are_as_described() -> None:
    discs, way = obstacles(mission("obstacles")), np.linspace(0.0, 1.0, 2000)[:, None] * [150.0, 100.0]
    near = np.hypot(way[:, None, 0] - discs[:, 0], way[:, None, 1] - discs[:, 1]) < discs[:, 2]
    assert (near.shape[1], int(near.any(axis=0).sum())) == (12, 4)  # the straight line meets four of twelve
    gusts = [fault for fault in mission("gusts").faults if isinstance(fault, Gust)]
    assert [(gust.duration_s, round(float(np.hypot(*gust.acceleration)), 1)) for gust in gusts] == [(1.0, 3.0)] * 4
    assert all(0 < len(gust.uavs) < 25 for gust in gusts)
    waves = mission("windmap")
    assert np.unique(launches(waves), return_counts=True)[1].tolist() == [5] * 5
    assert len(np.unique(goals(waves), axis=0)) == 25
    unknown = mission("unknown")
    assert unknown.known().wind == unknown.wind == Scenario().wind  # agents are not told the true wind
    assert (unknown.flown().wind.drag, unknown.flown().wind.mean) == (0.3, (3.0, -2.0))


@pytest.mark.parametrize(("name", "way_m"), [("swap", 50.0), ("streams", 70.0)])
def test_swap_and_streams_send_all_uavs_through_the_middle(name: str, way_m: float) -> None:
    flown = mission(name)
    origins, targets = starts(flown)[:, :2], goals(flown)
    assert flown.uavs == 64
    np.testing.assert_allclose(np.hypot(*(targets - origins).T), way_m)
    assert np.hypot(*((targets + origins) / 2).T).max() < 9.0


@pytest.mark.parametrize(("name", "least_m"), [("sphere", 49.0), ("layers", 5.0), ("tower", 3.0)])
def test_missions_in_space_lead_through_the_middle(name: str, least_m: float) -> None:
    flown = mission(name)
    origins, targets = starts(flown)[:, :3], goals(flown)
    np.testing.assert_allclose((origins + targets)[:, 2] / 2, 40.0)
    level = np.hypot(*(targets - origins)[:, :2].T)
    assert (level.max() == 0.0) == (name == "tower")
    assert np.linalg.norm(targets - origins, axis=-1).min() >= least_m
    assert flown.destination.radius < least_m


@pytest.mark.parametrize("name", ["sphere", "layers", "tower", "mast"])
def test_missions_in_space_end_with_all_arrived_and_no_collision(name: str) -> None:
    summary = Engine(mission(name, seed=2), name).complete()
    assert (summary["arrived"], summary["collisions_all"]) == (summary["uavs"], 0)
    assert (summary["obstacle_hits"], summary["grounded"]) == (0, 0)


def test_the_mast_is_in_the_way_of_the_lowest_layer() -> None:
    flown = mission("mast", method="cruise").replace(**{"filter.kind": "none"})
    assert Engine(flown, "mast").complete()["obstacle_hits"] > 0
    assert flown.stations[0].place[2] == flown.obstacles[0].height


def test_on_the_lossy_radio_half_of_all_states_are_lost_and_most_uploads() -> None:
    radio = mission("lossy").radio
    for bits, outage in ((64, 0.5), (4 * 32, 0.5), (108 * 32, 0.86)):
        assert expected(radio, np.ones(1), bits)[0] == pytest.approx(outage, abs=0.005)
