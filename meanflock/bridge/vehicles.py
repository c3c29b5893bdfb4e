"""The UAVs of a flight as MAVLink vehicles, sent to addresses over UDP; and a recorded flight, played in time."""

import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType

import numpy as np

from meanflock.bridge.mavlink import Base, Home, MavlinkFleet
from meanflock.net.access import Address
from meanflock.results.flown import FlightSoFar
from meanflock.results.series import per_uav, states_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.state import States
from meanflock.swarm.wire.messages import Telemetry


class Vehicles:
    """All UAVs of a flight that have a system id; a context that closes its sockets."""

    def __init__(
        self,
        uavs: int,
        dt: float,
        to: Sequence[Address],
        home: Home,
        clock: Callable[[], float] = time.monotonic,
        base: Base | None = None,
    ) -> None:
        """`dt`: seconds a tick. `to`: addresses that get every message. `base`: place of a station, which is the home
        of all vehicles.

        Raises:
            BadInput: nothing can be sent to an address.
        """
        self._fleet = MavlinkFleet(uavs, dt, home, base)
        self.count = len(self._fleet)
        self._clock = clock
        self._sockets: list[socket.socket] = []
        try:
            for address in to:
                self._sockets.append(_connected(address))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Vehicles":
        return self

    def __exit__(self, _t: type[BaseException] | None, _e: BaseException | None, _b: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the sockets."""
        for link in self._sockets:
            link.close()

    def send(self, tick: int, states: States, status: np.ndarray) -> None:
        """Send the positions of a tick, and heartbeats that are due; a datagram is one vehicle's.

        `states`: (N, 4), of a tick. `status`: (N,).
        """
        for datagram in self._fleet.datagrams(tick, states, status, self._clock()):
            for link in self._sockets:
                with suppress(OSError):  # nobody listens there now
                    link.send(datagram)

    def write(self, block: Telemetry) -> None:
        """Send all ticks of a block of telemetry."""
        for row, states in enumerate(block.states):
            self.send(block.first_tick + row, states, block.status[row])


def _connected(address: Address) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    link = socket.socket(family, socket.SOCK_DGRAM)
    try:
        link.connect(address)
    except OSError as error:
        link.close()
        raise BadInput(f"--to {address}: {error.strerror}; name a host and a port that can be reached") from error
    return link


def play(
    flight: FlightSoFar,
    vehicles: Vehicles,
    speed: float,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Send a recorded flight, each tick at its time; `speed`: how many times faster than it was simulated.

    Raises:
        BadInput: the time series is damaged.
    """
    start = clock()
    for piece in flight.pieces():
        states, status = states_of(piece.rows), per_uav(piece.rows, "status")[..., 0]
        for row, tick in enumerate(piece.rows["tick"].to_pylist()):
            left = start + tick * flight.scenario.dt / speed - clock()
            if left > 0.0:
                sleep(left)
            vehicles.send(tick, states[row], status[row])
