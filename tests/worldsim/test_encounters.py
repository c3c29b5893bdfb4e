"""Metrics: encounters and UAVs on the ground, worked by hand; alignment, risk and energy, as the oracle has them."""

import json
import math
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock import kernels
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.scenario import load
from meanflock.worldsim.flight import Flight, Pairs, pairs
from meanflock.worldsim.summary import flight_summary
from tests.worldsim.flights import calm, idle, power, put


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


ORACLES = Path(__file__).parents[1] / "oracle"
ORACLE = json.loads((ORACLES / "metrics.json").read_text())
POWER = json.loads((ORACLES / "power.json").read_text())
PARTS = ("radio", "compute", "total")
METRICS = load(None).metrics
RTOL = 1e-9
cases = pytest.mark.parametrize("case", ORACLE, ids=lambda case: f"N{case['N']}")


def at_rest(states: state.States) -> Pairs:
    return pairs(METRICS, states, states, math.inf)


def states_of(case: dict[str, Any]) -> state.States:
    return np.concatenate([case["position"], case["velocity"]], axis=-1)


@cases
def test_alignment_and_risk_are_the_oracle_s(case: dict[str, Any]) -> None:
    n, seen = case["N"], [at_rest(instant) for instant in states_of(case)]
    alignment = np.mean([kernels.alignment(instant) for instant in states_of(case)])
    assert alignment == pytest.approx(case["phi_A_as_printed"], rel=RTOL)
    near = 2 * np.mean([one.near for one in seen])
    assert (near + n) / n**2 == pytest.approx(case["phi_C_as_printed"], rel=RTOL)
    assert near / (n * (n - 1)) == pytest.approx(case["phi_C_distinct_pairs"], rel=RTOL)


def test_power_is_the_oracle_s() -> None:
    speeds = np.array([case["speed_m_s"] for case in POWER], dtype=float)
    expected = [case["power_W"] for case in POWER]
    np.testing.assert_allclose(power(speeds), expected, rtol=1e-9)


def test_radio_and_controllers_have_an_energy_that_changes_no_flight() -> None:
    settings = ["uavs=4", "duration=5", "stop=duration"]
    priced = ["energy.radio_W=0.5", "energy.step_J=0.001"]
    free, paid = (Engine(load(None, [*settings, *more], method="orca"), "x").complete() for more in ([], priced))
    assert paid["trajectory_sha256"] == free["trajectory_sha256"]
    motion = 4 * free["energy_end_mean_J"]
    airtime = free["radio"]["airtime_s"]
    assert airtime > 0
    assert [free[f"energy_{part}_J"] for part in PARTS] == pytest.approx([0.0, 0.0, motion])
    expected = [0.5 * airtime, 0.001 * 4 * 50, motion + 0.5 * airtime + 0.2]
    assert [paid[f"energy_{part}_J"] for part in PARTS] == pytest.approx(expected)


def test_lost_uavs_compute_nothing() -> None:
    kill = "faults=[{kind='kill', time_s=2.0, uavs=[1, 2]}]"
    settings = ["uavs=4", "duration=5", "stop=duration", "energy.step_J=1", kill]
    summary = Engine(load(None, settings, method="cruise"), "x").complete()
    assert summary["lost"] == 2
    assert summary["energy_compute_J"] == 2 * 50 + 2 * 20
