"""Collisions, obstacle hits and UAVs on the ground, worked by hand."""

import math
from itertools import combinations

import numpy as np
import pytest

from meanflock.swarm import state
from meanflock.swarm.scenario import load
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.summary import flight_summary
from tests.worldsim.flights import calm, idle, put


def segment_distance(first: np.ndarray, last: np.ndarray) -> float:
    """Distance from the origin to the segment between two points, sampled and then refined about the best sample."""
    low, high = 0.0, 1.0
    for _ in range(6):
        shares = np.linspace(low, high, 201)
        apart = np.hypot(*(first + shares[:, None] * (last - first)).T)
        best = int(apart.argmin())
        low, high = shares[max(best - 1, 0)], shares[min(best + 1, 200)]
    return float(apart[best])


def test_encounters_are_the_closest_approaches_of_all_segments() -> None:
    """A dense swarm in waves with arrived, lost and diverged UAVs, resumed on the way."""
    discs = "obstacles=[{centre=[92.3, 2.6], radius=0.4}, {centre=[94.1, 0.3], radius=0.2}]"
    keys = ["uavs=12", "start.formation=waves", "start.group=4", "start.interval=0.5", "start.spacing=0.6"]
    keys += ["start.centre=[90.0, 0.0]", "wind.sigma=0.3", "destination.radius=1", discs]
    flight, draw = Flight(load(None, keys)), np.random.default_rng(4)
    put(flight, 0, position=(0.0, 0.0))
    history, events = [flight.states], list(flight.events)
    touched, collided, hit, nearest = set(), set(), set(), math.inf
    for tick in range(80):
        if tick == 40:
            events, snapshot = flight.events, flight.snapshot()
            flight = Flight(flight.scenario)
            flight.restore(snapshot, np.array(history))
        before, flying = flight.states, flight.on_way.copy()
        aloft = flight.launch_tick <= tick
        wanted = draw.normal(size=(12, 2)) * 12.0 - 0.5 * (before[:, state.POSITION] - [93.0, 1.5])
        if tick == 12:
            wanted[3, 0] = np.inf
        if tick == 20:
            flight.lose(np.array([5, 6]), "lost", "a test")
            flying[[5, 6]] = False
        flight.advance(wanted)
        history.append(flight.states)
        aloft[3] &= tick != 12  # put back
        first, last = before[:, state.POSITION], flight.states[:, state.POSITION]
        for i, j in combinations(np.flatnonzero(aloft).tolist(), 2):
            apart = segment_distance(first[i] - first[j], last[i] - last[j])
            nearest = min(nearest, apart)
            if apart < 0.1:
                touched.add((i, j))
                collided |= {(i, j)} if flying[i] and flying[j] else set()
        for uav in np.flatnonzero(aloft).tolist():
            for number, disc in enumerate(flight.scenario.obstacles):
                if segment_distance(first[uav] - disc.centre, last[uav] - disc.centre) < disc.radius:
                    hit.add((uav, number))
    found = flight.encounters
    assert (found.collided, found.touched) == (collided, touched)
    assert {(uav, disc) for uav, disc in np.argwhere(found.hit).tolist()} == hit
    assert found.closest_approach_m == pytest.approx(nearest, abs=1e-9)
    named = sorted(event.uavs for event in events + flight.events if event.kind == "collision")
    assert named == sorted(collided)
    hits = sorted(event.uavs for event in events + flight.events if event.kind == "hit")
    assert hits == sorted((uav,) for uav, _ in hit)
    assert len(touched) > len(collided) > 3
    assert hit


def test_control_effort_is_the_integral_of_the_commands_until_arrival() -> None:
    flight = calm('stop="duration"', uavs=2)
    command = np.array([[0.3, 0.4], [0.0, 0.0]])
    put(flight, 0, position=(5.5, 0.0), velocity=(-2.0, 0.0))
    while flight.arrival_tick[0] < 0:
        flight.advance(command, gust=np.full((2, 2), -0.5))
    idle(flight)
    flight.advance(command)
    assert flight_summary(flight)["control_effort"] == pytest.approx(0.25 * flight.arrival_tick[0] * 0.1 / 2)
    assert flight.arrival_tick[0] > 3


WAVES = ("uavs=4", "start.formation=waves", "start.group=2", "start.interval=2")


def test_a_uav_before_its_launch_is_at_rest_and_counts_for_nothing() -> None:
    flight = Flight(load(None, [*WAVES, "start.spacing=0.05", "start.centre=[100.0, 0.0]"]))
    start, push = flight.states.copy(), np.full((4, 2), 0.5)
    gust = np.full((4, 2), 2.0)
    for _ in range(19):
        flight.advance(push, gust)
    np.testing.assert_array_equal(flight.states[2:], start[2:])
    assert not flight.energy[2:].any()
    assert flight.effort.tolist() == [pytest.approx(9.5), pytest.approx(9.5), 0.0, 0.0]
    assert flight.distance[2:].tolist() == [0.0, 0.0]
    assert len(flight.encounters.touched) == 1  # of the first wave: the second is on the ground
    speeds = flight.mean_speed
    assert speeds is not None
    assert speeds == pytest.approx(flight.distance[:2].sum() / (2 * 19 * 0.1))
    idle(flight)
    flight.advance(push)
    assert (flight.states[2:] != start[2:]).all()
    assert len(flight.encounters.touched) > 1


def test_travel_time_counts_from_the_launch() -> None:
    flight = Flight(load(None, [*WAVES, "start.centre=[3.0, 0.0]", "wind.sigma=0", "wind.mean=[0.0, 0.0]"]))
    idle(flight, 21)
    assert flight.arrival_tick.tolist() == [1, 1, 21, 21]
    assert flight_summary(flight)["t_avg_s"] == pytest.approx(0.1)
    assert flight.over
