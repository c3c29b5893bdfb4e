"""Vehicles of users: they fly and resume, and a wrong one ends the run with its mistake; the limit of acceleration."""

from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.checkpoint import Resumption
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.base import Hidden
from tests.testing.good import GoodVehicle


class Glider(GoodVehicle):
    """Counts its ticks beside its thrust."""

    name = "glider"

    def init(self, uavs: int) -> Hidden:
        return super().init(uavs) | {"flown": np.zeros((uavs, 2), dtype=np.int32)}

    def step(self, states: Any, hidden: Hidden, acceleration: Any, noise: Any) -> tuple[Any, Hidden]:
        moved, after = super().step(states, hidden, acceleration, noise)
        return moved, after | {"flown": hidden["flown"] + 1}


def scenario(*settings: str, vehicle: type = Glider) -> Scenario:
    plugins.register(vehicle)
    return load(None, ["uavs=4", "vehicle.model=glider", *settings])


def test_the_hidden_state_of_a_vehicle_goes_on_with_a_resumed_flight() -> None:
    flown = scenario("duration=25", 'stop="duration"')
    engine = Engine(flown, "glide", sinks=[kept := Kept()])
    whole = engine.complete()
    assert (engine.world.flight.hidden["flown"] == 250).all()
    carrier = next(block for block in kept.blocks if block.checkpoint)
    tick = carrier.first_tick + len(carrier.states) - 1
    states = np.concatenate([block.states for block in kept.blocks])[: tick + 1]
    resumed = Engine(flown, "glide", resume=Resumption.decode(carrier.checkpoint, states))
    hidden = resumed.world.flight.hidden
    assert hidden["flown"].dtype == np.int32
    assert (hidden["flown"] == tick).all()
    summary = resumed.complete()
    for name in ("trajectory_sha256", "energy_end_mean_J"):
        assert summary[name] == whole[name]


def test_who_leaves_every_bound_is_put_back_with_what_it_hides() -> None:
    flight = Flight(scenario())
    flight.advance(np.zeros((4, 2)))
    before, asked = flight.states.copy(), np.zeros((4, 2))
    asked[2] = 1e15
    flight.advance(asked)
    assert flight.status.tolist() == [0, 0, 2, 0]
    np.testing.assert_array_equal(flight.states[2, :2], before[2, :2])
    assert not flight.states[2, 2:].any()
    assert flight.hidden["flown"][:, 0].tolist() == [2, 2, 1, 2]
    assert np.isfinite(flight.energy).all()


def test_the_world_shortens_a_command_beyond_the_limit_keeps_its_direction_and_counts_it() -> None:
    flight = Flight(load(None, ["uavs=4", "vehicle.acceleration_max=2", "wind.sigma=0", "wind.drag=0"]))
    commands = np.array([[2.0, 0.0], [3.0, -4.0], [0.0, 2.0 + 1e-12], [0.0, 0.0]])
    flight.lose(np.array([3]), "test", "by the test")
    flight.advance(commands)
    np.testing.assert_allclose(flight.states[:, 2:], 0.1 * np.array([[2.0, 0.0], [1.2, -1.6], [0.0, 2.0], [0.0, 0.0]]))
    assert flight.clipped == 1
    assert flight.effort == pytest.approx([4.0, 4.0, 4.0, 0.0])
