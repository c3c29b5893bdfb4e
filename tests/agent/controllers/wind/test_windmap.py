"""Mapping the wind: the map, ways through it, measurements, ways of sharing them, and the energy they save."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Received
from meanflock.agent.controllers.wind.belief import WindGrid
from meanflock.agent.controllers.wind.route import ABREAST_M, SPEEDS_M_S, STATION_M, Fare, Router
from meanflock.federation.rules.base import Uploads
from meanflock.settings import scenario_of
from meanflock.swarm import mission, plugins
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.base import MeanWind
from meanflock.worldsim.vehicles.point_mass import PointMass

SLANTED = np.array([0.8, 0.6])


def grid(spacing: float = 10.0) -> WindGrid:
    return WindGrid(np.array([5.0, -3.0]), SLANTED, 60.0, 20.0, spacing, 1.0, 15.0)


def test_a_linear_wind_is_interpolated_exactly_and_is_constant_beyond_the_edge() -> None:
    map_ = grid()
    maps = (map_.nodes @ np.array([[0.1, -0.2], [0.3, 0.05]]))[None]
    inside = map_.nodes.mean(axis=0) + np.random.default_rng(0).uniform(-12, 12, (1, 30, 2))
    assert map_.at(maps, inside) == pytest.approx(inside @ np.array([[0.1, -0.2], [0.3, 0.05]]))
    corner = map_.nodes[0]
    assert map_.at(maps, (corner - 1e3 * SLANTED - 1e3 * np.array([-0.6, 0.8]))[None]) == pytest.approx(maps[:, 0])
    _, share = map_.shares(inside)
    assert share.sum(axis=-1) == pytest.approx(1.0)
    assert (share >= 0).all()


def test_the_mean_is_that_of_a_gaussian_field_measured_at_its_nodes() -> None:
    map_, draw = grid(), np.random.default_rng(2)
    which = np.array([2, 11, 30])
    wind, precision = draw.standard_normal((3, 2)), np.array([4.0, 1.0, 9.0])
    information = map_.informed(np.zeros(3, dtype=int), map_.nodes[which], wind, precision, 1)
    apart = ((map_.nodes[:, None] - map_.nodes[None]) ** 2).sum(axis=-1)
    kernel = (1.0 + apart / (4.0 * 15.0**2)) ** -2
    weights = np.linalg.solve(kernel[np.ix_(which, which)] + np.diag(1.0 / precision), wind)
    assert map_.mean(information)[0] == pytest.approx(kernel[:, which] @ weights, abs=1e-9)


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


def made(share: str, **settings: Any) -> Any:
    return plugins.create("controller", "windmap", {"share": share}, scenario_of("windmap", settings))


def flown(controller: Any, scenario: Scenario, ticks: int, noise: float = 0.0) -> tuple[dict[str, Any], np.ndarray]:
    """Memory and states after some ticks of the first wave, nobody receiving anything."""
    draw, vehicle = np.random.default_rng(0), PointMass(PointMass.Options(), scenario)
    states = mission.starts(scenario)[:5]
    memory = controller.init(np.arange(5), mission.starts(scenario))
    for tick in range(ticks):
        step = controller.step(memory, tick, states, ())
        memory = step.memory
        states, _ = vehicle.step(states, {}, step.acceleration, noise * draw.standard_normal((5, 2)))
    return memory, states


def test_without_noise_the_wind_is_measured_as_it_is() -> None:
    scenario = scenario_of("windmap", {"wind.sigma": 0.0})
    controller = plugins.create("controller", "windmap", {"spacing_m": 5.0}, scenario)
    memory, states = flown(controller, scenario, 102)
    felt = controller.step(memory, 102, states, ()).diagnostics[:, :2]
    assert felt == pytest.approx(MeanWind(scenario)(states), abs=0.1)


DEVIATION = 0.1 / np.sqrt(0.1) / 0.1  # of a measurement: σ √dt of velocity in a tick, over dt c0


def test_a_measurement_counts_by_its_noise() -> None:
    scenario = scenario_of("windmap", {})
    memory, _ = flown(made("none"), scenario, 100, noise=1.0)
    ticks = memory["information"][..., 2].sum(axis=1)
    assert ticks == pytest.approx(99 / DEVIATION**2)


def test_measurements_of_others_count_as_own_and_absurd_ones_do_not() -> None:
    controller = made("measurements")
    memory = controller.init(np.arange(3), mission.starts(controller.scenario))
    own = mission.starts(controller.scenario)[:3]
    payload = np.array([[100.0, 60.0, 1.0, -1.0], [100.0, 60.0, 1e6, 0.0]])
    received = (Received(0, np.array([7, 9]), payload, np.array([[0, 1], [1, 1], [1, 2]])),)
    step = controller.step(memory, 1, own, received)
    told = step.memory["information"]
    assert told[1].sum(axis=0) == pytest.approx(np.array([1.0, -1.0, 1.0]) * 20 / DEVIATION**2)
    assert (told[[0, 2]] == 0).all()
    assert step.refused.tolist() == [9]


def test_a_round_of_precisions_gives_every_uav_the_information_of_all() -> None:
    controller = made("precision")
    rows, nodes = np.arange(25), controller._grid.count
    memory = controller.init(rows, mission.starts(controller.scenario))
    information = np.abs(np.random.default_rng(0).standard_normal((25, nodes, 3)))
    information[5:] = 0.0  # on the ground yet
    information[:3, : nodes // 2] = 0.0
    uploads = Uploads.complete(controller.get(memory | {"information": information}), 1, rows)
    rule = plugins.create("aggregator", "precision", {}, controller.scenario)
    _, model = rule.step(rule.init(controller.parameters), uploads)
    memory = controller.set(memory | {"information": information}, rows, np.tile(model, (25, 1)))
    assert controller._information(memory)[17] == pytest.approx(information.sum(axis=0))
    _, model = rule.step({}, Uploads.complete(controller.get(memory), 2, rows))
    again = controller.set(memory, rows, np.tile(model, (25, 1)))
    assert controller._information(again) == pytest.approx(controller._information(memory))  # nothing counts twice


def test_shared_measurements_save_energy() -> None:
    costs = {}
    for method, options in (("straight", {}), ("windmap", {"controller.share": "measurements"})):
        summary = mf.fly("windmap", method=method, seed=3, **options).summary
        assert summary["arrived"] == 25
        costs[method] = summary["energy_mean_J"] + 0.05 * summary["t_avg_s"]
    assert costs["windmap"] < 0.9 * costs["straight"]
