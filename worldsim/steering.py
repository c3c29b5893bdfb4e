"""Steering: commands of outside clients in place of those of the controllers, in real time."""

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.events import SteeringBegan, SteeringEnded
from meanflock.swarm.state import Mask, States
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.crew import Crew
from meanflock.worldsim.tick import Acts, Row, Senses

LOCKSTEP = "--steer: only a flight in real time can be steered; add --realtime"
SILENCE_S = 1.0  # after which a UAV is given back to its controller


class Setpoint(NamedTuple):
    """Acceleration (m/s², along x, y and z; z is for a flight in space) that a client asks of a UAV; its address."""

    uav: int
    acceleration: tuple[float, float, float]
    client: str


class Port(Protocol):
    """Where clients are heard and told."""

    def receive(self) -> Iterable[Setpoint | tuple[MessageRejected, str]]:
        """What came since the last call, in order: setpoints, and errors with the address of their sender."""

    def tell(self, tick: int, states: States, status: np.ndarray) -> None:
        """Tell the clients the states (N, 4) and the status (N,) of a tick."""


class Steered:
    """Crew around a crew: setpoints of clients replace commands. As a sink, it tells the clients each tick."""

    def __init__(self, crew: Crew, port: Port, counters: Counters, clock: Callable[[], float] = time.monotonic) -> None:
        """`counters`: count messages that are rejected. `clock`: seconds, monotonic."""
        self._crew = crew
        self._port = port
        self._counters = counters
        self._clock = clock
        self._has_begun = False
        self._wanted: dict[int, tuple[float, Setpoint]] = {}  # the last setpoint of each UAV, and when it came
        self._steered: set[int] = set()  # UAVs, now

    def answer(self, senses: Senses) -> tuple[Acts, Mask]:
        """See `Crew.answer`. A lost or paused UAV is not steered."""
        if not self._has_begun:
            self._has_begun = True
            for _ in self._port.receive():  # what came before take-off
                pass
        acts, absent = self._crew.answer(senses)
        now = self._clock()
        for received in self._port.receive():
            if isinstance(received, Setpoint):
                self._wanted[received.uav] = now, received
            elif dropped := self._counters.drop(*received, senses.tick):
                acts.news.append(dropped)
        wanted = {
            uav: setpoint
            for uav, (since, setpoint) in self._wanted.items()
            if now - since <= SILENCE_S and senses.awake[uav] and (senses.idle is None or not senses.idle[uav])
        }
        for uav in sorted(self._steered - wanted.keys()):
            acts.news.append(SteeringEnded(senses.tick, uav))
        for uav in sorted(wanted.keys() - self._steered):
            acts.news.append(SteeringBegan(senses.tick, uav, wanted[uav].client))
        self._steered = set(wanted)
        if wanted:
            acts.steered = len(wanted)
            acts.commands, absent = acts.commands.copy(), absent.copy()
            axes = state.axes(senses.states)
            for uav, setpoint in wanted.items():
                acts.commands[uav, :axes], absent[uav] = setpoint.acceleration[:axes], False
        return acts, absent

    def write(self, row: Row) -> None:
        """Tell the clients a row."""
        self._port.tell(row.tick, row.states, row.status)
