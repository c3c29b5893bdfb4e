"""Books of a flight: blocks of ticks give the bits of single ticks, whoever reads them and whenever."""

import numpy as np
import pytest

from meanflock.federation.post import Post
from meanflock.swarm.scenario import load
from meanflock.worldsim.barrier import Commands
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.summary import Counters, flight_summary, protocol_summary

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
