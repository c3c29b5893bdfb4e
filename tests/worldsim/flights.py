"""A flight without wind, put together by hand."""

from typing import Any

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.scenario import load
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.point_mass import PointMass


def power(speed: np.ndarray) -> np.ndarray:
    """In W, of speeds in m/s."""
    states = np.zeros((len(speed), state.SIZE))
    states[:, state.VX] = speed
    return PointMass(PointMass.Options(), load(None)).power(states, {}, np.zeros((len(speed), 2)))


def calm(*settings: str, uavs: int = 3) -> Flight:
    """A flight in which only commands move anyone; the UAVs stand 10 m apart."""
    return Flight(load(None, [f"uavs={uavs}", "wind.sigma=0", "wind.drag=0", "start.spacing=10", *settings]))


def put(flight: Flight, uav: int, *, position: Any, velocity: Any = (0.0, 0.0)) -> None:
    states = flight.states.copy()
    states[uav, state.POSITION], states[uav, state.VELOCITY] = position, velocity
    flight.states = states


def idle(flight: Flight, ticks: int = 1) -> None:
    for _ in range(ticks):
        flight.advance(np.zeros((flight.scenario.uavs, 2)))


def kinds(flight: Flight) -> list[tuple[str, tuple[int, ...]]]:
    return [(event.kind, event.uavs) for event in flight.events]
