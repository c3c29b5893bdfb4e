"""The mean difference of velocities: of all pairs of a swarm, and of a sample of the pairs of a large one."""

import math

import numpy as np
import pytest

from meanflock import kernels
from meanflock.swarm.scenario import load
from meanflock.swarm.stateful import restore, state_of
from meanflock.worldsim.alignment import EXACT, speed_difference
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.summary import flight_summary


def swarm(uavs: int) -> np.ndarray:
    """UAVs in two groups, one of which is slow; all far from the origin."""
    draw = np.random.default_rng(uavs)
    return draw.normal(size=(uavs, 4)) * [1e3, 1e3, 0.5, 0.5] + np.where(draw.random((uavs, 1)) < 0.3, 0.5, 12.0)


def test_all_pairs_of_up_to_3000_uavs_are_measured() -> None:
    states = swarm(EXACT)
    assert speed_difference(states, 1, 0) == (kernels.alignment(states), 0.0)


@pytest.mark.parametrize("uavs", [EXACT + 1, 20_000])
def test_estimates_of_a_large_swarm_are_as_far_from_all_pairs_as_their_standard_error_says(uavs: int) -> None:
    states = swarm(uavs)
    exact = kernels.alignment(states)
    estimates = [speed_difference(states, 1, tick) for tick in range(50)]
    deviations = np.array([(mean - exact) / math.sqrt(squared) for mean, squared in estimates])
    assert abs(deviations.mean()) < 4.0 / math.sqrt(50)
    assert deviations.std() == pytest.approx(1.0, abs=4.0 / math.sqrt(2 * 50))
    assert all(math.sqrt(squared) < 0.005 * exact for _, squared in estimates)


def test_the_pairs_depend_on_seed_and_tick_only() -> None:
    states = swarm(EXACT + 1)
    first = speed_difference(states, 1, 7)
    assert speed_difference(states, 1, 7) == first
    assert first.mean not in (speed_difference(states, 1, 8).mean, speed_difference(states, 2, 7).mean)


def test_equal_velocities_have_no_difference() -> None:
    assert speed_difference(np.full((EXACT + 1, 4), 0.7), 1, 0) == (0.0, 0.0)


def large() -> Flight:
    flight = Flight(load(None, [f"uavs={EXACT + 1}", "wind.sigma=0.3"], method="offline"))
    for _ in range(2):
        flight.advance(np.zeros((EXACT + 1, 2)))
    return flight


def test_a_summary_has_the_standard_error_and_a_resumed_flight_the_same() -> None:
    flight, resumed = large(), Flight(large().scenario)
    ticks = [flight.states]
    restore(resumed, state_of(flight))
    resumed.rehash(np.array([resumed.states] * 2 + ticks))
    for each in (flight, resumed):
        each.advance(np.zeros((EXACT + 1, 2)))
    found, again = flight_summary(flight), flight_summary(resumed)
    assert 0.0 < found["phi_A_standard_error"] < 0.005 * found["phi_A"]
    names = ("phi_A", "phi_A_standard_error")
    assert [again[name] for name in names] == [found[name] for name in names]


def test_a_swarm_whose_pairs_are_all_measured_has_no_standard_error() -> None:
    assert flight_summary(Flight(load(None, [f"uavs={EXACT}"], method="offline")))["phi_A_standard_error"] is None
