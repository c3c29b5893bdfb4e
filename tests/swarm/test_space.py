"""Space: keys with two and three numbers, layouts, and what a flight in the plane or in space refuses."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.swarm import mission, plugins, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load


def in_space(*settings: str) -> mf.Scenario:
    return load(None, ["space.dimensions=3", *settings])


def test_every_shipped_scenario_is_one_in_space_too_level_and_at_its_height() -> None:
    for name in ("swap", "streams", "windy", "faults"):
        flat = mf.Scenario.load(name)
        space = flat.replace(**{"space.dimensions": 3})
        starts, goals = state.position(mission.starts(space)), mission.goals(space)
        np.testing.assert_array_equal(state.flat(starts), state.position(mission.starts(flat)))
        np.testing.assert_array_equal(state.flat(goals), mission.goals(flat))
        assert (starts[:, 2] == flat.start.height).all()
        assert (goals[:, 2] == flat.start.height).all()


def test_the_hash_of_a_scenario_in_the_plane_does_not_know_of_space() -> None:
    flat = mf.Scenario(method="cruise")
    assert flat.sha256() == mf.Scenario(method="cruise", space={"dimensions": 2}).sha256()
    assert flat.sha256() != mf.Scenario(method="cruise", space={"dimensions": 3}).sha256()


def test_a_place_has_a_height_of_its_own_or_that_of_the_start() -> None:
    scenario = in_space(
        "uavs=2", "start.positions=[[1,2],[3,4,5]]", "start.height=7", "destination.positions=[[0,0,0],[9,9]]"
    )
    np.testing.assert_array_equal(mission.starts(scenario)[:, :3], [[1, 2, 7], [3, 4, 5]])
    np.testing.assert_array_equal(mission.goals(scenario), [[0, 0, 0], [9, 9, 7]])


def test_wind_and_gusts_of_two_numbers_are_level() -> None:
    scenario = in_space()
    np.testing.assert_array_equal(scenario.space.vector(scenario.wind.mean), [1.0, -1.0, 0.0])


@pytest.mark.parametrize("formation", ["grid", "waves", "streams"])
def test_layers_lie_one_above_the_other_about_the_centre(formation: str) -> None:
    scenario = in_space("uavs=24", f"start.formation={formation}", "start.layers=3", "start.group=4", "start.spacing=2")
    places = state.position(mission.starts(scenario))
    heights, counts = np.unique(places[:, 2], return_counts=True)
    np.testing.assert_allclose(heights, [38.0, 40.0, 42.0])
    assert counts.tolist() == [8, 8, 8]
    apart = np.linalg.norm(places[:, None] - places, axis=-1) + 9.0 * np.eye(24)
    assert apart.min() == pytest.approx(2.0)
    if formation == "waves":  # the last rows of a grid are short
        np.testing.assert_allclose(places.mean(axis=0), [150.0, 100.0, 40.0])


def test_a_sphere_is_evenly_covered_and_its_opposite_goals_are_on_it() -> None:
    scenario = in_space("uavs=100", "start.formation=sphere", "start.radius=10", "destination.goals=opposite")
    centre = np.array([150.0, 100.0, 40.0])
    places, goals = state.position(mission.starts(scenario)) - centre, mission.goals(scenario) - centre
    np.testing.assert_allclose(np.linalg.norm(places, axis=-1), 10.0)
    np.testing.assert_allclose(goals, -places)
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=0.1)
    apart = np.linalg.norm(places[:, None] - places, axis=-1) + 99.0 * np.eye(100)
    assert (apart.min(axis=1) > 0.7 * np.sqrt(4 * np.pi / 100) * 10.0).all()  # of the side of a square of equal area


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["start.centre=[1,2,3]"], "`start.centre` has three numbers, and the flight is in the plane"),
        (["uavs=1", "start.positions=[[1,2,3]]"], "`start.positions` has three numbers"),
        (["uavs=1", "destination.positions=[[1,2,3]]"], "`destination.positions` has three numbers"),
        (["wind.mean=[1,2,3]"], "`wind.mean` has three numbers"),
        (["truth.wind=[1,2,3]"], "`truth.wind` has three numbers"),
        (["faults=[{kind='gust',tick=1,duration_s=1,acceleration=[1,2,3]}]"], "`faults[0].acceleration` has three"),
        (["destination.goals=vertical"], '"vertical" needs space; set `space.dimensions` to 3, or take other goals'),
        (["start.layers=2"], "`start.layers` has no effect in the plane; set `space.dimensions` to 3"),
        (["start.formation=sphere"], '"sphere" needs space; set `space.dimensions` to 3'),
        (["space.dimensions=3", "start.formation=circle", "start.layers=2"], "`start.layers` has no effect here"),
        (["space.dimensions=3", "start.centre=[1,2,-3]"], "UAV 0 starts 3 m below the ground, z = 0; raise its place"),
        (["space.dimensions=3", "start.layers=90"], "`start.layers` is 90, but `uavs` is 25"),
        (
            ["space.dimensions=3", "uavs=1", "destination.positions=[[1,2,-3]]"],
            "UAV 0 has its goal 3 m below the ground",
        ),
        (["space.floor=3"], "`space.floor` has no effect in the plane; set `space.dimensions` to 3, or leave it out"),
        (["space.ceiling=3"], "`space.ceiling` has no effect in the plane"),
        (["space.dimensions=3", "space.floor=-1"], "space.floor: expected a number >= 0.0"),
        (["space.dimensions=3", "space.ceiling=0"], "space.ceiling: expected a number > 0.0"),
        (["space.dimensions=3", "space.floor=9", "space.ceiling=9"], "`space.floor` 9 m is not below `space.ceiling`"),
        (
            ["space.dimensions=3", "space.floor=41"],
            "UAV 0 starts 1 m below `space.floor` 41 m; move the limit, its place",
        ),
        (["space.dimensions=3", "space.ceiling=38.5"], "UAV 0 starts 1.5 m above `space.ceiling` 38.5 m"),
        (
            ["space.dimensions=3", "uavs=2", "space.floor=5", "destination.positions=[[1,2],[3,4,2]]"],
            "UAV 1 has its goal 3 m below `space.floor`",
        ),
        (["obstacles=[{centre=[9,9,9],radius=1}]"], "`obstacles[0].centre` has three numbers, and the flight is in"),
        (["obstacles=[{centre=[9,9],radius=1,height=3}]"], "`obstacles[0].height` has no effect in the plane"),
        (
            ["space.dimensions=3", "obstacles=[{centre=[9,9],radius=1,height=0}]"],
            "obstacles[0].height: expected a number",
        ),
        (
            ["space.dimensions=3", "obstacles=[{centre=[9,9,9],radius=1,height=3}]"],
            "`obstacles[0]` is a sphere, because its `centre` has three numbers, and has no `height`",
        ),
        (["space.dimensions=3", "obstacles=[{centre=[150,100,43],radius=3}]"], "UAV 12 starts inside `obstacles[0]`"),
        (["space.dimensions=3", "obstacles=[{centre=[150,100],radius=0.5,height=40}]"], "UAV 12 starts inside"),
        (["space.dimensions=4"], "space.dimensions: expected one of 2, 3, got 4"),
        (["start.centre=[1,2,3,4]"], "start.centre: expected a list of length <= 3"),
        (["space.dimensions=3", "stations=[{place=[150,100,40.5]}]"], "stands 0.5 m from the start of UAV 12"),
    ],
)
def test_a_scenario_that_contradicts_its_dimensions_is_refused(settings: list[str], words: str) -> None:
    with pytest.raises(BadInput) as error:
        load(None, settings)
    assert words in str(error.value)


def test_starts_beside_and_above_an_obstacle_are_free_and_the_hash_knows_heights_only_where_they_are() -> None:
    free = in_space(
        "obstacles=[{centre=[150,100,43.1],radius=3},{centre=[150,100],radius=9,height=39.9},{centre=[9,9],radius=1}]"
    )
    np.testing.assert_array_equal(mission.obstacles(free), [[150, 100, 3], [150, 100, 9], [9, 9, 1]])
    np.testing.assert_array_equal(mission.solids(free)[:, 3:], [[43.1, 43.1], [-np.inf, 39.9], [-np.inf, np.inf]])
    flat = load(None, ["obstacles=[{centre=[9,9],radius=1}]"])
    assert mission.solids(flat).shape == (1, 3)
    assert flat.sha256() == "0d89d68765a38acb777587e4ac2d37e16701981214477604fa5b839b9bc704e3"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"method": "windmap"},
            "controller 'windmap' flies in 2 dimensions, and `space.dimensions` is 3; take one that does (",
        ),
        ({"method": "cruise", "filter.kind": "flat"}, "filter 'flat' flies in 2 dimensions"),
        ({"method": "cruise", "vehicle.model": "flat"}, "vehicle 'flat' flies in 2 dimensions"),
    ],
)
def test_a_plug_in_that_does_not_declare_space_is_refused_there(settings: dict[str, Any], words: str) -> None:
    class FlatFilter(mf.Controller):
        plugin_kind = "filter"  # type: ignore[assignment]
        name = "flat"

        def step(self, *_: Any) -> Any: ...

    class FlatVehicle(mf.Vehicle):
        name = "flat"

        def step(self, *_: Any) -> Any: ...

        def power(self, *_: Any) -> Any: ...

    for each in (FlatFilter, FlatVehicle):
        plugins.register(each)
    try:
        with pytest.raises(BadInput) as error:
            mf.fly(mf.Scenario(**settings, **{"space.dimensions": 3}))
        assert words in str(error.value)
        assert "or set `space.dimensions` to 2" in str(error.value)
    finally:
        for kind in ("filter", "vehicle"):
            plugins.registry.registered.pop((kind, "flat"))  # type: ignore[call-overload]


def test_dimensions_of_a_plug_in_are_numbers_of_axes() -> None:
    class Deep(mf.Controller):
        name = "deep"
        dimensions = (4,)

        def step(self, *_: Any) -> Any: ...

    with pytest.raises(BadInput, match=r"`dimensions` is \(4,\); it must be \(2,\), \(3,\) or \(2, 3\)"):
        plugins.register(Deep)
