"""What a metre costs: the power of the vehicle itself, and the best speed among those compared."""

import numpy as np
import pytest

from meanflock.agent.controllers.wind.airspeed import SPEEDS_M_S, Fare
from meanflock.settings import scenario_of
from meanflock.worldsim.vehicles.point_mass import PointMass

AIR = {"vehicle.power_speed": "air", "wind.mean": [0.0, 0.0]}


def test_a_metre_costs_what_the_vehicle_takes_for_it() -> None:
    scenario = scenario_of("paper", AIR)
    for price in (0.0, 0.05, 0.5):
        cost, speed = Fare(scenario, price).best(np.zeros(1), np.zeros(1))
        states = np.array([[0.0, 0.0, speed[0], 0.0]])
        flown = PointMass(PointMass.Options(), scenario).power(states, {}, np.zeros((1, 2)))
        assert cost == pytest.approx((flown + price) / speed, rel=1e-12)


def test_the_best_speed_is_the_best_and_rises_with_the_price_of_time() -> None:
    scenario = scenario_of("paper", AIR)
    still = np.zeros(1)
    speeds = []
    for price in (0.0, 0.05, 0.5):
        fare = Fare(scenario, price)
        cost, speed = fare.best(still, still)
        each = (scenario.vehicle.power(SPEEDS_M_S**2, SPEEDS_M_S) + price) / SPEEDS_M_S
        assert cost[0] == each.min()
        speeds.append(float(speed[0]))
    assert speeds == sorted(speeds)
    assert speeds[0] == pytest.approx(2.25, abs=0.13)  # of least energy a metre


def test_a_wind_from_behind_carries_and_only_where_the_air_counts() -> None:
    air, ground = (
        Fare(scenario_of("paper", AIR | {"vehicle.power_speed": speed}), 0.05) for speed in ("air", "ground")
    )
    along, across = np.array([2.0, 0.0, -2.0, 0.0]), np.array([0.0, 0.0, 0.0, 2.0])
    costs, speeds = air.best(along, across)
    assert costs[0] < costs[1] < costs[3] < costs[2]
    assert speeds[0] > speeds[1]
    assert len(set(ground.best(along, across)[0].tolist())) == 1
