"""A flight: arrivals, losses, encounters and prices, by hand and by the oracle; sums of diagnostics."""

import json
import math
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock import kernels
from meanflock.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.events import Lost
from meanflock.swarm.scenario import load
from meanflock.swarm.stateful import restore, state_of
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.encounters import pairs
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.summary import flight_summary

ORACLES = Path(__file__).parents[1] / "oracle"


def calm(*settings: str, uavs: int = 3) -> Flight:
    """A flight in which only commands move anyone; the UAVs stand 10 m apart."""
    return Flight(load(None, [f"uavs={uavs}", "wind.sigma=0", "wind.drag=0", "start.spacing=10", *settings]))


def put(flight: Flight, uav: int, *, position: Any, velocity: Any = (0.0, 0.0)) -> None:
    states = flight.states.copy()
    states[uav] = *position, *velocity
    flight.states = states


def idle(flight: Flight, ticks: int = 1) -> None:
    for _ in range(ticks):
        flight.advance(np.zeros((flight.scenario.uavs, 2)))


def kinds(flight: Flight) -> list[tuple[str, tuple[int, ...]]]:
    return [(event.kind, event.uavs) for event in flight.events]


def test_an_arrival_is_recorded_once_with_its_time_energy_distance_and_effort() -> None:
    flight = calm('stop="duration"')
    put(flight, 1, position=(7.5, 0.0), velocity=(-2.0, 0.0))
    idle(flight, 50)  # passes the destination and leaves it again in the end
    arrived = int(flight.arrival_tick[1])
    # ‖s‖ ≤ 5 mixes metres and m/s: √(x² + 4) ≤ 5 first holds at x = 4.58.
    assert arrived == pytest.approx(14.6, abs=1)
    assert flight.status.tolist() == [Status.FLYING, Status.ARRIVED, Status.FLYING]
    energy, distance = flight.arrival_energy[1], flight.distance[1]
    assert energy == pytest.approx(arrived * 0.1 * 0.10419266955518902)  # W at 2 m/s, by the oracle
    assert distance == pytest.approx(0.2 * arrived)
    idle(flight, 100)
    assert not (state.norm(flight.states)[1] <= 5.0)
    assert (flight.arrival_tick[1], flight.arrival_energy[1], flight.distance[1]) == (arrived, energy, distance)
    assert flight.energy[1] > energy
    assert kinds(flight) == [("arrived", (1,))]
    assert flight.events[0].tick == arrived
    flight.advance(np.ones((3, 2)), gust=np.ones((3, 2)))
    assert flight.effort == pytest.approx([2.0, 0.0, 2.0])  # of commands until arrival
    assert flight_summary(flight)["control_effort"] == pytest.approx(4.0 * 0.1 / 3)
    assert flight_summary(flight)["t_avg_s"] == pytest.approx(0.1 * arrived)


def test_the_flight_is_over_when_everyone_arrived_or_is_lost_or_at_its_duration() -> None:
    flight = calm("duration=2", uavs=2)
    put(flight, 0, position=(0.0, 0.0))
    idle(flight)
    assert not flight.over
    flight.lose(np.array([1]), Lost, "a test")
    assert flight.over
    until_the_end = calm("duration=2", 'stop="duration"', uavs=1)
    put(until_the_end, 0, position=(0.0, 0.0))
    while not until_the_end.over:
        idle(until_the_end)
    assert until_the_end.tick == 20


def test_a_lost_uav_gets_no_command_and_never_arrives() -> None:
    flight = calm()
    put(flight, 0, position=(1.0, 0.5), velocity=(1.0, 2.0))
    flight.lose(np.array([0]), Lost, "a test")
    flight.lose(np.array([0]), Lost, "twice")
    for _ in range(5):
        flight.advance(np.ones((3, 2)))
    np.testing.assert_allclose(flight.states[0], [1.5, 1.5, 1.0, 2.0])
    assert (flight.status[0], flight.arrival_tick[0]) == (Status.LOST, -1)  # though it is at the goal
    np.testing.assert_allclose(state.velocity(flight.states)[1], 0.5)
    assert kinds(flight) == [("lost", (0,))]
    assert flight_summary(flight)["lost"] == 1


@pytest.mark.parametrize("command", [np.nan, np.inf, -np.inf, 1e308, -1e12])
def test_an_absurd_command_loses_the_uav_and_leaves_the_others_as_they_were(command: float) -> None:
    settings = ["uavs=4", "wind.sigma=0.3"]
    flight, honest = Flight(load(None, settings)), Flight(load(None, settings))
    draw = np.random.default_rng(1)
    for tick in range(20):
        wanted = draw.standard_normal((4, 2))
        honest.advance(wanted)
        if tick >= 5:
            wanted[2, 1] = command
        flight.advance(wanted)
        assert np.isfinite(flight.states).all()
    assert flight.status.tolist() == [0, 0, Status.LOST, 0]
    assert kinds(flight) == [("diverged", (2,))]
    assert flight.events[0].tick == 6
    others = [0, 1, 3]
    np.testing.assert_array_equal(flight.states[others], honest.states[others])
    np.testing.assert_array_equal(flight.energy[others], honest.energy[others])
    for value in flight_summary(flight).values():
        assert not isinstance(value, float) or np.isfinite(value)


# -- encounters, and UAVs on the ground ------------------------------------------------------------------------------


def segment_distance(first: np.ndarray, last: np.ndarray) -> float:
    """Distance from the origin to the segment between two points."""
    moved = last - first
    share = np.clip(-(first @ moved) / max(moved @ moved, 1e-300), 0.0, 1.0)
    return float(np.hypot(*(first + share * moved)))


def test_encounters_are_the_closest_approaches_of_all_segments() -> None:
    """A dense swarm in waves with arrived, lost and diverged UAVs, resumed on the way."""
    discs = "obstacles=[{centre=[92.3, 2.6], radius=0.4}, {centre=[94.1, 0.3], radius=0.2}]"
    keys = ["uavs=12", "start.formation=waves", "start.group=4", "start.interval=0.5", "start.spacing=0.6"]
    keys += ["start.centre=[90.0, 0.0]", "wind.sigma=0.3", "destination.radius=1", discs]
    flight, draw = Flight(load(None, keys)), np.random.default_rng(4)
    put(flight, 0, position=(0.0, 0.0))
    history, events = [flight.states], list(flight.events)
    touched, collided, at_ticks, hit, nearest = set(), set(), set(), set(), math.inf
    for tick in range(80):
        if tick == 40:
            events, snapshot = flight.events, state_of(flight)
            flight = Flight(flight.scenario)
            restore(flight, snapshot)
            flight.rehash(np.array(history))
        before, flying = flight.states, flight.on_way.copy()
        aloft = flight.launch_tick <= tick
        wanted = draw.normal(size=(12, 2)) * 12.0 - 0.5 * (state.position(before) - [93.0, 1.5])
        if tick == 12:
            wanted[3, 0] = np.inf
        if tick == 20:
            flight.lose(np.array([5, 6]), Lost, "a test")
            flying[[5, 6]] = False
        flight.advance(wanted)
        history.append(flight.states)
        aloft[3] &= tick != 12  # put back
        first, last = state.position(before), state.position(flight.states)
        for i, j in combinations(np.flatnonzero(aloft).tolist(), 2):
            apart = segment_distance(first[i] - first[j], last[i] - last[j])
            nearest = min(nearest, apart)
            if apart < 0.1:
                touched.add((i, j))
                collided |= {(i, j)} if flying[i] and flying[j] else set()
                at_ticks |= {(i, j)} if flying[i] and flying[j] and np.hypot(*(last[i] - last[j])) < 0.1 else set()
        for uav in np.flatnonzero(aloft).tolist():
            for number, disc in enumerate(flight.scenario.obstacles):
                if segment_distance(first[uav] - disc.centre, last[uav] - disc.centre) < disc.radius:
                    hit.add((uav, number))
    found = flight.encounters
    assert (found.collided, found.touched, found.collided_at_ticks) == (collided, touched, at_ticks)
    assert {(uav, disc) for uav, disc in np.argwhere(found.hit).tolist()} == hit
    assert found.closest_approach_m == pytest.approx(nearest, abs=1e-9)
    named = sorted(event.uavs for event in events + flight.events if event.kind == "collision")
    assert named == sorted(collided)
    hits = sorted(event.uavs for event in events + flight.events if event.kind == "hit")
    assert hits == sorted((uav,) for uav, _ in hit)
    assert len(touched) > len(collided) > len(at_ticks) > 0
    assert hit


@pytest.mark.parametrize(("start", "apart", "expected"), [(0.5, 1.0, (1, 0)), (0.5, 0.45, (1, 1)), (2.0, 1.0, (0, 0))])
def test_a_pair_that_passes_between_two_ticks_does_not_collide_at_ticks(
    start: float, apart: float, expected: tuple[int, int]
) -> None:
    """UAV 0 flies `apart` m in a tick towards UAV 1, which stands `start` m ahead."""
    flight = calm(uavs=2)
    put(flight, 0, position=(50.0 - start, 0.0), velocity=(apart / 0.1, 0.0))
    put(flight, 1, position=(50.0, 0.0))
    idle(flight)
    summary = flight_summary(flight)
    assert (summary["collisions"], summary["collisions_at_ticks"]) == expected


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


# -- alignment, risk and energy --------------------------------------------------------------------------------------

ORACLE = json.loads((ORACLES / "metrics.json").read_text())
PARTS = ("radio", "compute", "total")


@pytest.mark.parametrize("case", ORACLE, ids=lambda case: f"N{case['N']}")
def test_alignment_and_risk_are_the_oracle_s(case: dict[str, Any]) -> None:
    n, history = case["N"], np.concatenate([case["position"], case["velocity"]], axis=-1)
    alignment = np.mean([kernels.alignment(states) for states in history])
    assert alignment == pytest.approx(case["phi_A_as_printed"], rel=1e-9)
    near = 2 * np.mean([pairs(load(None).metrics, states, states, math.inf).near for states in history])
    assert (near + n) / n**2 == pytest.approx(case["phi_C_as_printed"], rel=1e-9)
    assert near / (n * (n - 1)) == pytest.approx(case["phi_C_distinct_pairs"], rel=1e-9)


def test_radio_and_controllers_have_an_energy_that_changes_no_flight_and_lost_uavs_compute_nothing() -> None:
    settings = ["uavs=4", "duration=5", "stop=duration", "faults=[{kind='kill', time_s=2.0, uavs=[1, 2]}]"]
    priced = ["energy.radio_W=0.5", "energy.step_J=0.001"]
    free, paid = (Engine(load(None, [*settings, *more], method="orca"), "x").complete() for more in ([], priced))
    assert paid["trajectory_sha256"] == free["trajectory_sha256"]
    assert paid["lost"] == 2
    motion, airtime, steps = 4 * free["energy_end_mean_J"], free["radio"]["airtime_s"], 2 * 50 + 2 * 20
    assert airtime > 0
    assert [free[f"energy_{part}_J"] for part in PARTS] == pytest.approx([0.0, 0.0, motion])
    expected = [0.5 * airtime, 0.001 * steps, motion + 0.5 * airtime + 0.001 * steps]
    assert [paid[f"energy_{part}_J"] for part in PARTS] == pytest.approx(expected)


@pytest.mark.parametrize(("uavs", "columns"), [(1, 1), (1, 3), (9, 1), (40, 1), (40, 2), (200, 1), (200, 4)])
def test_diagnostics_are_summed_tick_by_tick(uavs: int, columns: int) -> None:
    draw, commands = np.random.default_rng(uavs), Commands(uavs, 2, columns)
    everyone, total, largest = np.ones(uavs, bool), np.zeros(columns), np.zeros(columns)
    on_way = everyone
    for tick in range(75):
        if tick % 20 == 13:
            on_way = draw.random(uavs) < 0.7
        numbers = draw.normal(0, 10.0 ** draw.integers(-5, 5), (uavs, 2 + columns))
        replied = everyone if tick % 9 else draw.random(uavs) < 0.5
        commands.store(numbers, replied, everyone, on_way)
        counted = np.where(replied[:, None], numbers[:, 2:], 0.0)
        np.testing.assert_array_equal(commands.diagnostics, counted)
        total = total + np.add.reduce(counted[on_way], axis=0)
        largest = np.maximum(largest, np.abs(counted).max(axis=0))
        if tick % 31 == 0:
            commands.settle()
            np.testing.assert_array_equal(commands.summed, total)
    commands.settle()
    np.testing.assert_array_equal(commands.summed, total)
    np.testing.assert_array_equal(commands.largest, largest)
