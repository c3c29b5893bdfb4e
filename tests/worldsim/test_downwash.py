"""Wind with height and downwash: cases by hand, what they change, and where they are refused."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.downwash import WAKES, Downwash, acceleration
from meanflock.worldsim.vehicles.base import MeanWind

WAKE = WAKES["crazyflie"]
CALM = {"wind.sigma": 0.0, "space.dimensions": 3}


def states_at(*places: tuple[float, float, float]) -> np.ndarray:
    return np.concatenate([np.array(places), np.zeros((len(places), 3))], axis=-1)


def by_hand(below_m: float, aside_m: float) -> float:
    force_N = 2267.18 * (0.0231348 / (4 * below_m)) ** 2
    return float(force_N * np.exp(-0.5 * (aside_m / (0.16 * below_m - 0.11)) ** 2) / 0.027)


def test_the_wake_of_a_crazyflie_is_the_published_formula() -> None:
    for below, aside in ((1.0, 0.0), (2.0, 0.1), (3.0, 0.5), (0.6, 0.01), (0.4, 0.05)):
        found = acceleration(WAKE, np.array([below]), np.array([aside * aside]))[0]
        assert found == pytest.approx(min(by_hand(below, aside), 9.81))
    assert by_hand(1.0, 0.0) == pytest.approx(2.81, abs=0.01)


def test_a_wake_is_bounded_next_to_the_rotor_and_where_it_has_no_width() -> None:
    near = acceleration(WAKE, np.array([1e-9, 1e-300, 0.6875]), np.array([0.0, 0.0, 0.01]))
    assert near.tolist() == [9.81, 9.81, 0.0]


def test_wakes_of_all_uavs_above_add_up_and_those_on_the_ground_have_none() -> None:
    wash = Downwash(Scenario(uavs=4, wind={"downwash": "crazyflie"}, space={"dimensions": 3}))
    states = states_at((0.0, 0.0, 13.0), (0.0, 0.0, 11.0), (0.0, 0.0, 10.0), (10.5, 0.0, 5.0))
    found = wash.added(None, states, None)
    assert found is not None
    expected = [0.0, -by_hand(2, 0), -by_hand(3, 0) - by_hand(1, 0), 0.0]
    np.testing.assert_allclose(found, np.array([[0.0, 0.0, push] for push in expected]))
    gust = np.ones((4, 3))
    waiting = np.array([True, False, False, False])
    added = wash.added(gust, states, waiting)
    np.testing.assert_allclose(added - gust, [[0, 0, 0], [0, 0, 0], [0, 0, -by_hand(1, 0)], [0, 0, 0]])
    assert (gust == 1.0).all()


def test_without_downwash_a_gust_stays_what_it_is() -> None:
    off, gust = Downwash(Scenario(uavs=2, space={"dimensions": 3})), np.ones((2, 3))
    assert off.added(gust, np.zeros((2, 6)), None) is gust
    assert off.added(None, np.zeros((2, 6)), None) is None


def test_a_uav_below_another_is_pushed_down_in_flight() -> None:
    places = ((60.0, 0.0, 42.0), (60.0, 0.0, 40.0), (60.0, 9.0, 38.0))
    keys: dict[str, Any] = {"uavs": 3, "method": "cruise", "duration": 5.0, "start": {"positions": places}, **CALM}
    calm = mf.fly(Scenario(**keys)).states
    flown = mf.fly(Scenario(**keys, **{"wind.downwash": "crazyflie"})).states
    np.testing.assert_array_equal(flown[:, [0, 2]], calm[:, [0, 2]])
    assert flown[1, 1, 5] == pytest.approx(calm[1, 1, 5] - 0.1 * by_hand(2.0, 0.0))


def test_the_mean_wind_grows_with_the_height_by_a_power_law() -> None:
    keys = {"wind.profile_exponent": 0.25, "wind.mean": (4.0, -2.0), "start.height": 16.0, "space.dimensions": 3}
    wind = MeanWind(Scenario(**keys))
    assert not wind.uniform
    found = wind(states_at((0, 0, 16.0), (5, 5, 1.0), (0, 0, 0.0), (0, 0, -1.0), (9, 0, 81.0)))
    np.testing.assert_allclose(found, np.array([1.0, 0.5, 0.0, 0.0, 1.5])[:, None] * [4.0, -2.0, 0.0])
    field = MeanWind(Scenario(**keys, **{"wind.field_rms": 1.0}))(states_at((3, 4, 1.0)))
    alone = MeanWind(Scenario(**(keys | {"wind.mean": (0.0, 0.0)}), **{"wind.field_rms": 1.0}))(states_at((3, 4, 1.0)))
    np.testing.assert_allclose(field - alone, [[2.0, -1.0, 0.0]])


def test_uavs_know_the_wind_at_the_height_of_the_start() -> None:
    keys: dict[str, Any] = {"uavs": 2, "method": "cruise", "duration": 2.0, "wind.drag": 0.3, **CALM}
    start = {"positions": ((60.0, 0.0, 40.0), (60.0, 9.0, 10.0)), "height": 40.0}
    goals = {"positions": ((0.0, 0.0, 40.0), (0.0, 9.0, 10.0))}
    uniform = mf.fly(Scenario(**keys, start=start, destination=goals)).states
    flown = mf.fly(Scenario(**keys, start=start, destination=goals, **{"wind.profile_exponent": 0.2})).states
    np.testing.assert_array_equal(flown[:, 0], uniform[:, 0])
    assert flown[-1, 1, 0] < uniform[-1, 1, 0] - 0.01  # the wind of 1 m/s against it is weaker than it knows


def test_a_flight_with_both_is_drawn(tmp_path: Any) -> None:
    keys = {"wind.profile_exponent": 0.2, "wind.downwash": "crazyflie", "start.layers": 2, **CALM}
    run = mf.fly(Scenario(uavs=8, method="cruise", duration=2.0, **keys), out=tmp_path, record=True)
    assert run.summary["ticks"] == 20


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"wind.profile_exponent": 0.2}, "`wind.profile_exponent` has no effect in the plane; set `space.dimensions`"),
        ({"wind.downwash": "crazyflie"}, "`wind.downwash` has no effect in the plane"),
        ({"wind.downwash": "crazyflie", "space.dimensions": 3, "uavs": 2001}, "take 2000 at most, or leave it out"),
        ({"wind.profile_exponent": -0.1, "space.dimensions": 3}, "wind.profile_exponent: expected a number >= 0.0"),
        ({"wind.downwash": "owl", "space.dimensions": 3}, "wind.downwash"),
    ],
)
def test_wind_that_contradicts_its_flight_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput) as error:
        Scenario(**keys)
    assert words in str(error.value)
