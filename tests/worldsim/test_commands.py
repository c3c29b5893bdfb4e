"""Commands: the world uses those of active UAVs whose node replied, and none beyond the bound."""

import numpy as np
import pytest

from meanflock.federation.post import Post
from meanflock.swarm.scenario import load
from meanflock.swarm.state import BEYOND_SENSE
from meanflock.worldsim.replies import Commands
from meanflock.worldsim.summary import Counters, protocol_summary

UAVS = 5
ALL = np.ones(UAVS, dtype=bool)


def said(scale: float = 1.0) -> np.ndarray:
    return np.random.default_rng(1).normal(0, scale, (UAVS, 5))


@pytest.mark.parametrize("column", range(5))
@pytest.mark.parametrize("size", [BEYOND_SENSE, -BEYOND_SENSE, np.inf, np.nan])
def test_a_command_beyond_the_bound_is_named_and_not_used(size: float, column: int) -> None:
    commands, numbers = Commands(UAVS, 3), said()
    numbers[2, column] = numbers[4, 0] = size
    assert commands.store(numbers, ALL & (np.arange(UAVS) != 4), ALL, ALL).tolist() == [2]  # 4 has not replied
    assert commands.accelerations.any(axis=-1).tolist() == [True, True, False, True, False]
    assert commands.largest.max() < BEYOND_SENSE


def test_diagnostics_of_uavs_on_the_way_add_up() -> None:
    commands, numbers, on_way = Commands(UAVS, 3), said(), np.array([True, False, True, True, False])
    commands.store(numbers, ALL, ALL, on_way)
    commands.store(numbers, ALL, ALL, ALL)
    twice = commands.diagnostics[on_way].sum(axis=0) + commands.diagnostics.sum(axis=0)
    np.testing.assert_allclose(commands.summed, twice, rtol=1e-12)
    said_of = protocol_summary(Counters(), Post(load(None)), commands, ["a", "b", "c"], None, 0)
    assert list(said_of["diagnostics"].values()) == commands.summed.tolist()
    assert said_of["diagnostics_max"] == dict(zip("abc", commands.largest.tolist(), strict=True))
