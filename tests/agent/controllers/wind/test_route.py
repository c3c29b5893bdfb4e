"""Ways through a wind: straight where it is the same everywhere, around where it is against, and never dearer."""

import numpy as np
import pytest

from meanflock.agent.controllers.wind.airspeed import Fare
from meanflock.agent.controllers.wind.belief import WindGrid
from meanflock.agent.controllers.wind.route import ABREAST_M, STATION_M, Router
from meanflock.settings import scenario_of

BACK = np.array([1.0, 0.0])
GRID = WindGrid(np.array([-10.0, 0.0]), BACK, 140.0, 30.0, 10.0, 1.0, 20.0)
FARE = Fare(scenario_of("paper", {"vehicle.power_speed": "air"}), 0.05)
ROUTER = Router(FARE, BACK, 120.0, 30.0, np.zeros(2))
GOAL, START = np.zeros((1, 2)), np.array([[120.0, 0.0]])


def ways(maps: np.ndarray, start: np.ndarray = START) -> tuple[np.ndarray, np.ndarray]:
    return ROUTER.ways(GRID, maps, np.repeat(GOAL, len(maps), axis=0), start)


def wind(of: np.ndarray) -> np.ndarray:
    return np.broadcast_to(of, (1, GRID.count, 2)).copy()


def test_in_still_air_the_way_is_straight_at_one_speed() -> None:
    offsets, speeds = ways(wind(np.zeros(2)))
    assert (offsets == 0).all()
    assert len(set(speeds[0].tolist())) == 1
    assert speeds[0, 5] == FARE.best(np.zeros(1), np.zeros(1))[1][0]


def test_a_lane_with_the_wind_from_behind_is_taken() -> None:
    lane = np.where(GRID.nodes[:, 1] > 10.0, -3.0, 1.0)[:, None] * BACK  # to the goal is −x
    offsets, speeds = ways(lane[None])
    assert offsets[0, 10] >= 10.0
    assert offsets[0, 0] == 0.0
    assert np.abs(np.diff(offsets[0])).max() <= 2 * ABREAST_M
    assert speeds[0, 10] > 3.0


def test_no_straight_way_at_any_offset_is_cheaper() -> None:
    maps = np.random.default_rng(0).standard_normal((1, GRID.count, 2))
    offsets, _ = ways(maps)

    def price(way: np.ndarray) -> float:
        steps = np.diff(way)
        stretch = np.sqrt(1.0 + (steps / STATION_M) ** 2)
        heading = np.stack([-np.ones_like(steps), -steps / STATION_M], axis=-1) / stretch[:, None]
        middle = np.stack([(np.arange(len(steps)) + 0.5) * STATION_M, way[1:]], axis=-1)
        air = GRID.at(maps, middle[None])[0]
        along = (air * heading).sum(axis=-1)
        across = air[:, 1] * heading[:, 0] - air[:, 0] * heading[:, 1]
        return float((FARE.best(along, across)[0] * stretch).sum() * STATION_M)

    best = price(offsets[0])
    assert best < price(np.zeros(ROUTER.stations))
    draw = np.random.default_rng(1)
    for _ in range(50):  # any other way on the same places
        moves = draw.integers(-1, 2, ROUTER.stations - 1) * ABREAST_M
        other = np.concatenate([[0.0], np.cumsum(moves)])
        other[-1] = 0.0
        if np.abs(np.diff(other)).max() <= 2 * ABREAST_M and np.abs(other).max() <= 30.0:
            assert best <= price(other) + 1e-9


def test_who_is_far_beside_comes_back_to_the_goal() -> None:
    offsets, _ = ways(wind(np.zeros(2)), np.array([[60.0, 28.0]]))
    assert offsets[0, 10] == 27.0
    assert offsets[0, 0] == 0.0
    assert (np.diff(offsets[0, :11]) >= 0).all()


def test_a_row_has_the_same_bits_among_others() -> None:
    maps = np.random.default_rng(5).standard_normal((7, GRID.count, 2))
    starts = np.random.default_rng(6).uniform(-20, 100, (7, 2))
    together = ways(maps, starts)
    for row in range(7):
        of = slice(row, row + 1)
        alone = ways(maps[of], starts[of])
        assert all(one.tobytes() == many[of].tobytes() for one, many in zip(alone, together, strict=True))


def test_a_look_ahead_is_on_the_way() -> None:
    offsets, speeds = ways(wind(np.zeros(2)))
    place, speed = ROUTER.ahead(offsets, speeds, np.array([[50.0, 4.0]]), 6.0)
    assert place[0] == pytest.approx([44.0, 0.0])
    assert speed[0] == speeds[0, 9]
