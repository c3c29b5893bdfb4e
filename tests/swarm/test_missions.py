"""The missions that come with meanflock: each is what its first lines say, and flies."""

from pathlib import Path

import numpy as np
import pytest

from meanflock.channel.link import expected
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.faults import Gust
from meanflock.swarm.mission import goals, launches, obstacles, starts
from meanflock.swarm.scenario import Scenario, load

MISSIONS = ("windy", "unknown", "swap", "streams", "obstacles", "gusts", "lossy", "crowd", "windmap")


def mission(name: str, **options: object) -> Scenario:
    return load(Path(name), **options)


@pytest.mark.parametrize("name", MISSIONS)
def test_a_mission_flies_by_its_name(name: str) -> None:
    summary = Engine(mission(name, duration=2.0, method="cruise"), name).complete()
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


def test_on_the_lossy_radio_half_of_all_states_are_lost_and_most_uploads() -> None:
    radio = mission("lossy").radio
    for bits, outage in ((64, 0.5), (4 * 32, 0.5), (108 * 32, 0.86)):
        assert expected(radio, np.ones(1), bits)[0] == pytest.approx(outage, abs=0.005)
