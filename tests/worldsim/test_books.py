"""Books of a flight: blocks of ticks give the bits of single ticks, whoever reads them and whenever."""

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.plugins import registry
from meanflock.swarm.scenario import load
from meanflock.swarm.seeds import generator, random_state
from meanflock.worldsim.barrier import Commands
from meanflock.worldsim.books import Noise, block_ticks, sums
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.summary import flight_summary
from meanflock.worldsim.vehicles.base import Vehicle

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


def test_energies_are_added_up_tick_by_tick() -> None:
    flight = Flight(load(None, ["uavs=3"]))
    energy, dt = np.zeros(3), flight.scenario.dt
    for tick in range(block_ticks(3) + 7):
        flight.advance(np.full((3, 2), 0.1 * tick))
        speed = np.hypot(flight.states[:, 2], flight.states[:, 3])
        energy += flight.scenario.vehicle.power(speed * speed, speed) * dt
    np.testing.assert_allclose(flight.energy, energy, rtol=1e-13)


@pytest.mark.parametrize("tick", [1, 30, 50, 77])
def test_a_snapshot_in_a_block_continues_to_the_same_bits(tick: int) -> None:
    scenario = load(None, ["uavs=4", "wind.sigma=0.3"])
    whole, draw = Flight(scenario), np.random.default_rng(2)
    pushes = draw.normal(0, 1, (100, 4, 2))
    history = [whole.states]
    for push in pushes[:tick]:
        whole.advance(push)
        history.append(whole.states)
    resumed = Flight(scenario)
    resumed.restore(whole.snapshot(), np.stack(history))
    for push in pushes[tick:]:
        whole.advance(push)
        resumed.advance(push)
    assert flight_summary(resumed) == flight_summary(whole)
    assert resumed.snapshot()["wind"] == whole.snapshot()["wind"]


def test_the_wind_is_drawn_in_the_order_of_the_ticks() -> None:
    scenario = load(None, ["uavs=6"])
    noise, draw = Noise(scenario), generator(scenario.seed, "wind")
    for _ in range(block_ticks(6) + 3):
        np.testing.assert_array_equal(noise.next(), draw.standard_normal((6, 2)))
        assert noise.snapshot() == random_state(draw)


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


@pytest.mark.parametrize("uavs", [1, 2, 25, 1000])
def test_sums_add_row_after_row(uavs: int) -> None:
    begin, rows = np.random.default_rng(uavs).normal(size=uavs), np.random.default_rng(1).normal(size=(50, uavs))
    expected = begin.copy()
    for row, found in zip(rows, sums(begin, rows), strict=True):
        expected += row
        np.testing.assert_array_equal(found, expected)


def test_a_vehicle_whose_power_takes_one_tick_only_ends_the_run_with_its_mistake(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(registry, "registered", {})

    class Heavy(Vehicle):
        name = "heavy"

        def init(self, uavs):
            self.mass = np.linspace(1.0, 2.0, uavs)  # belongs in the hidden state
            return {}

        def step(self, states, hidden, acceleration, noise):
            return states + 0.0, hidden

        def power(self, states, hidden, acceleration):
            return self.mass * states[:, 2] ** 2

    plugins.register(Heavy)
    engine = Engine(load(None, ["uavs=4", "vehicle.model=heavy", "duration=1"]), "heavy")
    with pytest.raises(RunFailed, match=r"vehicle 'heavy': `power` failed.*\(of the rows of 10 ticks of 4 UAVs\)"):
        for _ in engine.fly():
            pass
