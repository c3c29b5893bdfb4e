"""Large swarms: memory grows with the number of UAVs and not with its square, for each controller that may fly them."""

import math
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from meanflock.launch import memory, run
from meanflock.launch.engine import Engine
from meanflock.results.run_folder import CHECKPOINT
from meanflock.swarm import declared, mission, plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.checkpoint import PART_BYTES
from tests.faults.dying import dead, resumed

FEW, MANY = 4200, 8400  # both above the numbers from which on things are done in another way
TICKS = 1
SLOW = {"windmap"}  # thousands of maps, one after the other: nobody flies that many


def massive() -> list[str]:
    """The built-in controllers whose memory does not grow with pairs of UAVs."""
    found = []
    for name in sorted({*plugins.names("controller")} - SLOW):
        try:
            if memory.pair_bytes(Scenario(uavs=FEW, method=name)) == 0:
                found.append(name)
        except BadInput:  # it needs an option
            continue
    return found


def peak(name: str, uavs: int) -> int:
    """Largest memory of a flight of a tick in one thread, from its scenario to its summary, bytes."""
    scenario = Scenario(uavs=uavs, method=name, duration=0.1 * TICKS, start={"spacing": 120.0 / math.sqrt(uavs)})
    tracemalloc.start()
    try:
        Engine(scenario, "massive", threads=1).complete()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", massive())
def test_memory_grows_with_the_number_of_uavs(name: str) -> None:
    assert peak(name, MANY) < 2.2 * peak(name, FEW) + 2**22


def test_what_claims_to_be_massive() -> None:
    assert {"mfgfl-hf", "mfgfl-h", "mfgfl-f", "mfg", "offline", "cruise", "lqr", "plan"} <= {*massive()}


def test_a_pairwise_method_of_a_large_swarm_is_refused_in_gib() -> None:
    with pytest.raises(BadInput, match=r"memory: [\d,]+\.\d GiB for 100000 UAVs in one process, .* GiB .*N²"):
        memory.check([Scenario(uavs=100_000, method="hjb")])


def test_a_swarm_whose_learners_all_diverge_is_lost_in_words() -> None:
    """The grid of the paper is far wider than these features bear; most UAVs are near a long segment in each tick."""
    wide = Scenario(uavs=5000, duration=1.1, start={"spacing": 20.0}, learner={"position_scale": 200.0})
    summary = Engine(wide, "diverging", threads=2).complete()
    assert summary["lost"] > 1000
    assert summary["ticks"] == 11


def test_features_are_as_wide_as_a_large_swarm() -> None:
    assert Scenario(uavs=20_000).position_scale_m == 200.0
    wide = Scenario(uavs=FEW, duration=1.1, start={"spacing": 20.0})
    assert wide.position_scale_m == pytest.approx(150.0 + 20.0 * 32.0)
    assert wide.resolved().learner.position_scale == wide.position_scale_m
    assert wide.sha256() == wide.replace(**{"learner.position_scale": wide.position_scale_m}).sha256()
    assert Engine(wide, "wide", threads=2).complete()["lost"] == 0


def test_a_killed_flight_of_a_large_swarm_resumes_to_the_same_bits(tmp_path: Path) -> None:
    flown = Scenario(uavs=FEW, duration=11.5, federation={"period": 40})
    folder = dead(tmp_path, flown, 108)
    assert (folder / CHECKPOINT).stat().st_size > PART_BYTES
    assert resumed(folder)["trajectory_sha256"] == Engine(flown, "whole").complete()["trajectory_sha256"]


def test_links_of_large_nodes_may_be_silent_for_longer() -> None:
    scenario = Scenario(uavs=100_000)
    assert [run._lease_s(scenario, rows) for rows in (1, 5000, 10**9)] == [None, None, pytest.approx(194.5)]


def test_goals_of_a_large_swarm_share_fits() -> None:
    scenario = Scenario(uavs=FEW, destination={"goals": "parallel"}, start={"spacing": 2.0})
    flyer = declared.controller(scenario)
    plan = mission.starts(scenario)
    weights = flyer.init(np.arange(FEW), plan)["weights"]
    kinds = np.unique(weights, axis=0)
    assert 1 < len(kinds) <= 64
    np.testing.assert_array_equal(flyer.init(np.arange(7, 9), plan)["weights"], weights[7:9])


@pytest.mark.parametrize(("uavs", "says"), [(10**9, r"needs \d+ GiB at least, and this machine has"), (2**31, "uavs")])
def test_more_uavs_than_memory_are_refused_with_a_number(uavs: int, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        Scenario.load("paper", uavs=uavs)
