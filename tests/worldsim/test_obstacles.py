"""Obstacles in space: ways that enter columns with a top and spheres, and controllers that fly round and over them."""

from functools import cache
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.sharing.nearby import Obstacles, closest_obstacles, edges
from meanflock.agent.controllers.sharing.olfati_saber import _along_edge
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.obstacles import entered

SOLIDS = [
    {"centre": (0.0, 0.0), "radius": 1.0, "height": 5.0},
    {"centre": (0.0, 0.0, 8.0), "radius": 2.0},
    {"centre": (3.0, 3.0), "radius": 0.5},
]
SPACE: dict[str, Any] = {"space.dimensions": 3, "obstacles": SOLIDS}
METHODS = ("vasarhelyi", "olfati-saber", "potential-field", "orca", "bvc")
SUBJECTS: dict[str, dict[str, Any]] = {
    **{method: {"method": method} for method in METHODS},
    **{kind: {"method": "cruise", "filter.kind": kind} for kind in ("ecbf", "braking")},
}


def test_ways_enter_obstacles_where_points_on_them_are_inside() -> None:
    draw = np.random.default_rng(5)
    before, after = draw.uniform(-4.0, 12.0, (2, 2000, 6))
    after[:50, 2] = before[:50, 2]
    after[50:100, :2] = before[50:100, :2]
    solids = mission.solids(Scenario(**SPACE))
    share = np.linspace(0.0, 1.0, 4001)[:, None, None]
    for uavs in np.array_split(np.arange(2000), 20):
        way = before[uavs, :3] + share * (after[uavs, :3] - before[uavs, :3])
        level = np.hypot(way[..., 0], way[..., 1])
        inside = [
            (level < 1.0) & (way[..., 2] <= 5.0),
            np.hypot(level, way[..., 2] - 8.0) < 2.0,
            np.hypot(way[..., 0] - 3.0, way[..., 1] - 3.0) < 0.5,
        ]
        expected = np.stack([one.any(axis=0) for one in inside], axis=-1)
        found = entered(solids, {}, before[uavs], after[uavs])
        assert not (expected & ~found).any()
        assert np.count_nonzero(found & ~expected) <= 1  # grazes it between two points


def test_a_uav_above_a_column_or_with_nan_enters_nothing() -> None:
    solids = mission.solids(Scenario(**SPACE))
    before, after = np.zeros((2, 3, 6))
    before[:, :3] = [[-3.0, 0.0, 5.1], [-3.0, 0.0, 4.9], [np.nan, np.nan, np.nan]]
    after[:, :3] = before[:, :3] + [6.0, 0.0, 0.0]
    assert entered(solids, {}, before, after).tolist() == [[False] * 3, [True, False, False], [False] * 3]


def test_what_controllers_see_of_obstacles() -> None:
    solids = Obstacles(Scenario(**SPACE))
    own = np.array([[2.0, 0.0, 4.0, 1.0, 2.0, 3.0], [0.0, 0.0, 6.0, 1.0, 2.0, 3.0]])
    seen = edges(own, solids)
    np.testing.assert_allclose(seen.distance[:, :2], [[1.0, np.sqrt(20.0) - 2.0], [0.0, 0.0]])
    np.testing.assert_allclose(np.stack(seen.away, axis=-1)[:, 0], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(seen.away[2][1, 1], -1.0)
    np.testing.assert_array_equal(seen.closing[2], [[0.0, 3.0, 0.0], [3.0, 3.0, 0.0]])
    near, radii = closest_obstacles(own, solids, 50.0, 3)
    np.testing.assert_array_equal(near.away[0], [[2.0, 0.0, 0.0], [2.0, 0.0, -4.0], [-1.0, -3.0, 0.0]])
    np.testing.assert_array_equal(near.closing[0], [[1.0, 2.0, 0.0], [1.0, 2.0, 3.0], [1.0, 2.0, 0.0]])
    np.testing.assert_array_equal(radii[0], [1.0, 2.0, 0.5])


def test_the_velocity_along_an_edge_is_the_part_at_right_angles() -> None:
    draw = np.random.default_rng(2)
    v, n = draw.normal(size=(2, 9, 1, 3))
    n /= state.length(n)[..., None]
    parts = _along_edge(state.parts(v), state.parts(n), np.full((9, 1), 0.25))
    np.testing.assert_allclose(np.stack(parts, axis=-1), 0.25 * (v - state.dot(v, n)[..., None] * n), atol=1e-12)


@pytest.mark.parametrize("subject", SUBJECTS.values(), ids=SUBJECTS)
def test_a_uav_flies_round_a_sphere_and_a_column_and_over_a_low_one(subject: dict[str, Any]) -> None:
    keys: dict[str, Any] = {"uavs": 1, "seed": 1, "duration": 90.0, "start.centre": (60.0, 0.0), **subject}
    solids = [
        {"centre": (45.0, 0.3, 40.2), "radius": 3.0},
        {"centre": (30.0, 0.2), "radius": 2.0, "height": 45.0},
    ]
    run = mf.fly(Scenario(**keys, space={"dimensions": 3}, obstacles=solids))
    assert (run.summary["obstacle_hits"], run.summary["arrived"]) == (0, 1)
    apart = state.length(state.position(run.states)[:, 0] - [45.0, 0.3, 40.2])
    assert apart.min() > 3.0
    low = [{"centre": (x, 0.0), "radius": 2.0, "height": 30.0} for x in (15.0, 20.0)]
    over = mf.fly(Scenario(**keys, space={"dimensions": 3}, obstacles=[*solids, *low]))
    assert over.summary["trajectory_sha256"] == run.summary["trajectory_sha256"]


def test_cruise_hits_the_sphere_and_the_high_column() -> None:
    solids = [{"centre": (45.0, 0.3, 40.2), "radius": 3.0}, {"centre": (30.0, 0.2), "radius": 2.0, "height": 45.0}]
    keys: dict[str, Any] = {"uavs": 1, "seed": 1, "start.centre": (60.0, 0.0), "method": "cruise"}
    run = mf.fly(Scenario(**keys, space={"dimensions": 3}, obstacles=solids, duration=60.0))
    assert run.summary["obstacle_hits"] == 2


WALL = {"polygon": [(20.0, -6.0), (32.0, -6.0), (32.0, 5.0), (26.0, 1.0), (20.0, 5.0)]}


def toward_the_wall(axes: int) -> dict[str, Any]:
    keys: dict[str, Any] = {"uavs": 2, "start.positions": ((50.0, -0.5), (50.0, 8.0)), "seed": 3, "duration": 90.0}
    return keys | {"start.height": 10.0, "space.dimensions": axes, "wind.sigma": 0.0, "vehicle.acceleration_max": 6.0}


@cache
def hits_of_cruise(axes: int, **height: float) -> int:
    """Hits of a controller that sees no wall, one as high as given."""
    run = mf.fly(Scenario(method="cruise", obstacles=[{**WALL, **height}], **toward_the_wall(axes)))
    return run.summary["obstacle_hits"]


@pytest.mark.parametrize("name", SUBJECTS)
@pytest.mark.parametrize("axes", [2, 3])
def test_controllers_and_filters_fly_round_a_polygon(name: str, axes: int) -> None:
    assert hits_of_cruise(axes) == 2
    run = mf.fly(Scenario(obstacles=[WALL], **toward_the_wall(axes), **SUBJECTS[name]))
    assert run.summary["obstacle_hits"] == 0
    if axes == 3:
        assert hits_of_cruise(axes, height=4.0) == 0
