"""A flight: arrivals, energy, collisions and losses are counted once and in time, and the hash sees every tick."""

import hashlib

import numpy as np
import pytest

from meanflock.swarm import state
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.summary import flight_summary
from tests.worldsim.flights import calm, idle, kinds, power, put


def test_an_arrival_is_recorded_once_with_its_time_energy_and_distance() -> None:
    flight = calm('stop="duration"')
    put(flight, 1, position=(7.5, 0.0), velocity=(-1.0, 0.0))
    idle(flight, 60)  # passes the destination and leaves it again in the end
    arrived = int(flight.arrival_tick[1])
    # ‖s‖ ≤ 5 mixes metres and m/s: √(x² + 1) ≤ 5 first holds at x = 4.8.
    assert arrived == pytest.approx(27, abs=1)
    assert flight.status.tolist() == [Status.FLYING, Status.ARRIVED, Status.FLYING]
    energy, distance = flight.arrival_energy[1], flight.distance[1]
    assert energy == pytest.approx(arrived * 0.1 * power(np.ones(1))[0])
    assert distance == pytest.approx(0.1 * arrived)
    idle(flight, 100)
    assert not (state.norm(flight.states)[1] <= 5.0)
    assert (flight.arrival_tick[1], flight.arrival_energy[1], flight.distance[1]) == (arrived, energy, distance)
    assert flight.energy[1] > energy
    assert kinds(flight) == [("arrived", (1,))]
    assert flight.events[0].tick == arrived
    assert flight_summary(flight)["t_avg_s"] == pytest.approx(0.1 * arrived)


def test_the_flight_is_over_when_everyone_arrived_or_is_lost_or_at_its_duration() -> None:
    flight = calm("duration=2", uavs=2)
    put(flight, 0, position=(0.0, 0.0))
    idle(flight)
    assert not flight.over
    flight.lose(np.array([1]), "lost", "a test")
    assert flight.over
    until_the_end = calm("duration=2", 'stop="duration"', uavs=1)
    put(until_the_end, 0, position=(0.0, 0.0))
    while not until_the_end.over:
        idle(until_the_end)
    assert until_the_end.tick == 20


def test_a_lost_uav_gets_no_command_and_never_arrives() -> None:
    flight = calm()
    put(flight, 0, position=(1.0, 0.5), velocity=(1.0, 2.0))
    flight.lose(np.array([0]), "lost", "a test")
    flight.lose(np.array([0]), "lost", "twice")
    for _ in range(5):
        flight.advance(np.ones((3, 2)))
    np.testing.assert_allclose(flight.states[0], [1.5, 1.5, 1.0, 2.0])
    assert (flight.status[0], flight.arrival_tick[0]) == (Status.LOST, -1)  # though it is at the goal
    np.testing.assert_allclose(flight.states[1, state.VELOCITY], 0.5)
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


def test_the_hash_is_of_all_states_from_take_off_as_little_endian_doubles() -> None:
    flight, draw, expected = Flight(load(None, ["uavs=3"])), np.random.default_rng(6), hashlib.sha256()
    expected.update(flight.states.astype("<f8").tobytes())
    hashes = {flight.trajectory_sha256}
    for _ in range(10):
        flight.advance(draw.standard_normal((3, 2)))
        expected.update(flight.states.astype("<f8").tobytes())
        assert flight.trajectory_sha256 == expected.hexdigest()
        hashes.add(flight.trajectory_sha256)
    assert len(hashes) == 11
