"""Polygons as obstacles: exact distances inside and outside, ways that enter, corners that are no polygon."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as some

from meanflock.agent.controllers.sharing.nearby import Obstacles, closest_obstacles, edges
from meanflock.swarm import mission
from meanflock.swarm.errors import BadInput
from meanflock.swarm.polygons import Polygon, problem
from meanflock.swarm.scenario import Scenario

SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
ELL = ((0.0, 0.0), (6.0, 0.0), (6.0, 2.0), (2.0, 2.0), (2.0, 6.0), (0.0, 6.0))  # with a corner that points inside
AWAY: dict[str, Any] = {"destination.goals": "opposite"}  # not at the origin
numbers = some.floats(-10.0, 10.0).map(lambda number: round(number, 3))
places = some.tuples(numbers, numbers)


def of(corners: Any, height: float | None = None) -> Polygon:
    return Polygon.of(tuple(corners), height)


@some.composite
def stars(draw: some.DrawFn) -> tuple[tuple[float, float], ...]:
    """Polygons whose corners go once around a centre, in either direction."""
    count = draw(some.integers(3, 9))
    radii = draw(some.lists(some.floats(1.0, 8.0), min_size=count, max_size=count))
    angles = 2.0 * math.pi * np.arange(count) / count
    corners = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles.tolist(), strict=True)]
    return tuple(corners if draw(some.booleans()) else corners[::-1])


def by_hand(corners: tuple[tuple[float, float], ...], place: tuple[float, float]) -> float:
    """Signed distance: from each side by its own formula, inside by the winding number."""
    least, turned = math.inf, 0.0
    for (x0, y0), (x1, y1) in zip(corners, (*corners[1:], corners[0]), strict=True):
        along, from_start = (x1 - x0, y1 - y0), (place[0] - x0, place[1] - y0)
        share = (along[0] * from_start[0] + along[1] * from_start[1]) / (along[0] ** 2 + along[1] ** 2)
        nearest = x0 + min(max(share, 0.0), 1.0) * along[0], y0 + min(max(share, 0.0), 1.0) * along[1]
        least = min(least, math.dist(nearest, place))
        one, other = math.atan2(from_start[1], from_start[0]), math.atan2(place[1] - y1, place[0] - x1)
        turned += math.remainder(other - one, 2.0 * math.pi)
    return -least if abs(turned) > math.pi else least


HAIR = 1e-16  # of a corner above the ray from a place, less than the sums of its sides can tell


@example(((0.7, -0.7), (0.0, -1.0), (-0.7, -0.7), (-1.0, HAIR), (-2.1, 2.1), (0.0, 1.0), (1.0, 0.0)), (-2.0, 0.0))
@given(stars(), places)
def test_the_distance_is_exact_inside_and_outside_and_outward_leads_out(corners: Any, place: Any) -> None:
    assert problem(corners) is None
    distance, outward, _ = of(corners).nearest(np.array([place]))
    expected = by_hand(corners, place)
    assume(abs(expected) > 1e-6)
    assert distance[0] == pytest.approx(expected, abs=1e-9)
    assert np.hypot(*outward[0]) == pytest.approx(1.0)
    on_edge = np.array(place) - distance[0] * outward[0]
    assert abs(by_hand(corners, tuple(on_edge))) < 1e-9
    assert of(corners).depth >= -expected


@given(stars(), some.lists(places, min_size=2, max_size=6))
def test_the_row_of_a_place_depends_on_it_alone(corners: Any, given_places: Any) -> None:
    together = of(corners).nearest(np.array(given_places))
    for row, place in enumerate(given_places):
        alone = of(corners).nearest(np.array([place]))
        assert all(one[row].tobytes() == other[0].tobytes() for one, other in zip(together, alone, strict=True))


@given(stars(), places, places)
def test_ways_enter_where_points_on_them_are_inside(corners: Any, first: Any, last: Any) -> None:
    way = np.array(first) + np.linspace(0.0, 1.0, 2001)[:, None] * (np.array(last) - np.array(first))
    least = of(corners).nearest(way).distance.min()
    assume(abs(least) > 0.02)  # it does not graze
    assert bool(of(corners).is_entered(np.array([first]), np.array([last]))[0]) == (least < 0.0)


def test_ways_of_the_square_and_of_nothing() -> None:
    square = of(SQUARE)
    first = np.array([[-1.0, 2.0], [-1.0, -1.0], [2.0, 2.0], [-1.0, 2.0], [np.nan, np.nan], [5.0, 0.0], [9.0, 4.0]])
    last = np.array([[9.0, 2.0], [-1.0, 9.0], [2.0, 2.0], [-1.0, 2.0], [2.0, 2.0], [5.0, 0.0], [9.0, 4.0]])
    assert square.is_entered(first, last).tolist() == [True, False, True, False, False, False, False]
    found = square.nearest(np.array([[2.0, 1.0], [2.0, -3.0], [7.0, 8.0], [2.0, 0.0]]))
    np.testing.assert_allclose(found.distance, [-1.0, 3.0, 5.0, 0.0])
    np.testing.assert_allclose(found.outward, [[0.0, -1.0], [0.0, -1.0], [0.6, 0.8], [0.0, -1.0]])
    assert found.slides.tolist() == [True, True, False, True]


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        (SQUARE[:2], "has 2 corners; give three at least"),
        (((0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.0)), "crosses itself: its sides 0 and 2 meet"),
        ((*SQUARE, (0.0, 4.0)), r"has the corner \[0.0, 4.0\] twice in a row"),
        (((0.0, 0.0), (4.0, 0.0), (2.0, 0.0)), "crosses itself"),
        (((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 0.0), (0.0, 4.0)), "crosses itself: its sides 0 and 2 meet"),
    ],
)
def test_corners_of_no_polygon_are_refused_by_the_key(corners: Any, expected: str) -> None:
    with pytest.raises(BadInput, match=rf"obstacles\[0\].*the `polygon` {expected}"):
        Scenario(obstacles=[{"polygon": corners}])


def test_a_polygon_has_no_disc_and_an_obstacle_is_one_of_them() -> None:
    with pytest.raises(BadInput, match=r"obstacles\[0\].*a `polygon` has no `centre` and no `radius`; leave these out"):
        Scenario(obstacles=[{"polygon": SQUARE, "radius": 2.0}])
    with pytest.raises(BadInput, match=r"obstacles\[0\].*`radius`; add it, or the corners of a `polygon`"):
        Scenario(obstacles=[{"centre": (3.0, 4.0)}])
    with pytest.raises(BadInput, match=r"`obstacles\[0\].height` has no effect in the plane"):
        Scenario(obstacles=[{"polygon": SQUARE, "height": 4.0}])
    with pytest.raises(BadInput, match=r"UAV 12 starts inside `obstacles\[0\]`"):
        Scenario(obstacles=[{"polygon": [(x + 149.0, y + 99.0) for x, y in SQUARE]}], **{"start.spacing": 9.0})


@pytest.mark.parametrize("axes", [2, 3])
def test_a_polygon_of_many_sides_looks_like_the_disc(axes: int) -> None:
    angles = 2.0 * math.pi * np.arange(100) / 100
    corners = (5.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)).tolist()
    top = {} if axes == 2 else {"height": 30.0}
    disc, polygon = (
        Obstacles(Scenario(obstacles=[one | top], **AWAY, **{"space.dimensions": axes}))
        for one in ({"centre": (0.0, 0.0), "radius": 5.0}, {"polygon": corners})
    )
    own = np.random.default_rng(3).uniform(-15.0, 15.0, (40, 2 * axes)) + ([0, 0, 30, 0, 0, 0] if axes == 3 else 0)
    for mine, other in zip(edges(own, polygon)[0:2], edges(own, disc)[0:2], strict=True):
        np.testing.assert_allclose(mine, other, atol=0.04)
    near = [closest_obstacles(own, obstacles, 100.0, 1) for obstacles in (polygon, disc)]
    np.testing.assert_allclose(near[0][0].away, near[1][0].away, atol=0.15)
    ell = Scenario(obstacles=[{"polygon": ELL}], **AWAY)
    assert mission.obstacles(ell).tolist() == [[3.0, 3.0, pytest.approx(18**0.5)]]
