"""Ways through a wind, and the cost of a metre: the power of the vehicle at its cheapest speed."""

import numpy as np
import pytest

from meanflock.agent.controllers.wind.belief import WindGrid
from meanflock.agent.controllers.wind.route import ABREAST_M, SPEEDS_M_S, STATION_M, Fare, Router
from meanflock.settings import scenario_of
from meanflock.worldsim.vehicles.point_mass import PointMass

AIR = {"vehicle.power_speed": "air", "wind.mean": [0.0, 0.0]}
BACK = np.array([1.0, 0.0])
GRID = WindGrid(np.array([-10.0, 0.0]), BACK, 140.0, 30.0, 10.0, 1.0, 20.0)
FARE = Fare(scenario_of("paper", {"vehicle.power_speed": "air"}), 0.05)
ROUTER = Router(FARE, BACK, 120.0, 30.0, np.zeros(2))
GOAL, START = np.zeros((1, 2)), np.array([[120.0, 0.0]])


def ways(maps: np.ndarray, start: np.ndarray = START) -> tuple[np.ndarray, np.ndarray]:
    return ROUTER.ways(GRID, maps, np.repeat(GOAL, len(maps), axis=0), start)


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


def test_a_metre_costs_the_power_of_the_vehicle_at_the_cheapest_speed() -> None:
    scenario, speeds = scenario_of("paper", AIR), []
    states = np.zeros((len(SPEEDS_M_S), 4))
    states[:, 2] = SPEEDS_M_S
    power = PointMass(PointMass.Options(), scenario).power(states, {}, np.zeros((len(states), 2)))
    for price in (0.0, 0.05, 0.5):
        cost, speed = Fare(scenario, price).best(np.zeros(1), np.zeros(1))
        each = (power + price) / SPEEDS_M_S
        assert cost[0] == pytest.approx(each.min(), rel=1e-12)
        assert speed[0] == SPEEDS_M_S[each.argmin()]
        speeds.append(float(speed[0]))
    assert speeds == sorted(speeds)
    assert speeds[0] == pytest.approx(2.25, abs=0.13)  # of least energy a metre
