"""The UDP port of `--steer`: reads setpoints of MAVLink clients, and tells each client of the vehicles."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import TracebackType

import numpy as np

from meanflock.bridge.mavlink import MavlinkFleet, Reader
from meanflock.net.access import Address
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.state import States
from meanflock.worldsim.steering import Setpoint

MOST_CLIENTS = 8  # that are told of the flight; others may steer
FORGOTTEN_S = 5.0  # after a client's last message
_MOST_DATAGRAMS = 1000  # read in a tick; more wait, as far as the system lets them
_MOST_BYTES = 2**16


class SteeringPort:
    """A bound socket, never waited for; a context that closes it."""

    def __init__(self, address: Address, uavs: int, dt: float, clock: Callable[[], float] = time.monotonic) -> None:
        """`dt`: seconds a tick.

        Raises:
            BadInput: the port is taken, or the host is not this machine.
        """
        self._clock = clock
        self._reader = Reader(uavs)
        self._fleet = MavlinkFleet(uavs, dt)
        self._clients: dict[tuple[str, int], float] = {}  # when each was last heard
        try:
            self._socket = address.bind()
        except OSError as error:
            raise address.refused("--steer", error) from error
        self._socket.setblocking(False)
        self.address = Address(*self._socket.getsockname()[:2])

    def __enter__(self) -> "SteeringPort":
        return self

    def __exit__(self, _t: type[BaseException] | None, _e: BaseException | None, _b: TracebackType | None) -> None:
        self._socket.close()

    def receive(self) -> Iterator[Setpoint | tuple[MessageRejected, str]]:
        """What came since the last call; see `steering.Port`."""
        for _ in range(_MOST_DATAGRAMS):
            try:
                datagram, sender = self._socket.recvfrom(_MOST_BYTES)
            except BlockingIOError:
                return
            except OSError:  # of an earlier answer: that client is gone
                continue
            client = str(Address(*sender[:2]))
            for read in self._reader.read(datagram):
                if isinstance(read, MessageRejected):
                    yield read, f"steering from {client}"
                    continue
                self._remember(sender)
                if read is not None:
                    yield Setpoint(read.uav, read.acceleration, client)

    def tell(self, tick: int, states: States, status: np.ndarray) -> None:
        """Send each client every vehicle's position, and heartbeats that are due."""
        now = self._clock()
        self._clients = {client: since for client, since in self._clients.items() if now - since <= FORGOTTEN_S}
        if not self._clients:
            return
        for datagram in self._fleet.datagrams(tick, states, status, now):
            for client in self._clients:
                with suppress(OSError):
                    self._socket.sendto(datagram, client)

    def _remember(self, client: tuple[str, int]) -> None:
        if client in self._clients or len(self._clients) < MOST_CLIENTS:
            if client not in self._clients:
                self._fleet.beat()  # so that it need not wait for a heartbeat
            self._clients[client] = self._clock()
