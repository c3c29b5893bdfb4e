"""A flight: arrivals and losses are counted once and in time; blocks of its books have the bits of single ticks."""

import hashlib

import numpy as np
import pytest

from meanflock.federation.post import Post
from meanflock.swarm import state
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.barrier import Commands
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.summary import Counters, flight_summary, protocol_summary
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


SWARM = [
    "uavs=5",
    "wind.sigma=0.2",
    "vehicle.acceleration_max=2",
    "destination.radius=180.6",
    "start.group=2",
    "start.interval=0.7",
]
TICKS = 130


def flown(settings: list[str], read_every: int) -> tuple[Flight, list[bytes]]:
    """A flight in which UAVs take off, arrive and get lost, and what was read of it every tenth tick."""
    flight, draw, seen = Flight(load(None, settings)), np.random.default_rng(4), []
    for tick in range(TICKS):
        flight.advance(draw.normal(0, 2, (5, 2)))
        if tick == 70:
            flight.lose(np.array([1]), "lost", "by the test")
        if tick == 95:
            flight.rejoin(np.array([1]), "agent")
        if read_every and tick % read_every == 0:
            flight.books.settle()
        if tick % 10 == 0:
            seen += [flight.energy.tobytes(), flight.distance.tobytes(), flight.effort.tobytes()]
            seen += [repr((flight.speed_max, flight.mean_speed, flight.trajectory_sha256)).encode()]
    return flight, seen


@pytest.mark.parametrize("read_every", [1, 7])
def test_the_books_of_a_block_are_those_of_each_tick(read_every: int) -> None:
    (flight, seen), (settled, expected) = flown(SWARM, 0), flown(SWARM, read_every)
    assert seen == expected
    assert flight_summary(flight) == flight_summary(settled)
    assert 0 < np.count_nonzero(flight.arrival_tick > 0) < 5
    assert flight.arrival_energy.tobytes() == settled.arrival_energy.tobytes()
    energies, single = (np.concatenate(one.books.energies) for one in (flight, settled))
    assert energies.shape == (TICKS + 1, 5)
    assert energies.tobytes() == single.tobytes()


@pytest.mark.parametrize(("uavs", "columns"), [(1, 1), (1, 3), (9, 1), (40, 1), (40, 2), (200, 1), (200, 4)])
def test_diagnostics_are_summed_tick_by_tick(uavs: int, columns: int) -> None:
    draw, commands = np.random.default_rng(uavs), Commands(uavs, columns)
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
            np.testing.assert_array_equal(commands.summed, total)
    np.testing.assert_array_equal(commands.summed, total)
    np.testing.assert_array_equal(commands.largest, largest)
    summary = protocol_summary(Counters(), Post(load(None)), commands, [*map(str, range(columns))], None, 0)
    assert [*summary["diagnostics"].values()] == total.tolist()
    assert [*summary["diagnostics_max"].values()] == largest.tolist()
