"""Steering: commands of outside clients in place of those of the controllers, in real time."""

from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol

import numpy as np

from meanflock.federation.post import Note
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.state import Mask, Plane, States
from meanflock.worldsim.summary import Counters

LOCKSTEP = "--steer: only a flight in real time can be steered; add --realtime"
SILENCE_S = 1.0  # after which a UAV is given back to its controller


class Setpoint(NamedTuple):
    """Acceleration (m/s², along x and y) that a client asks of a UAV; the client's address."""

    uav: int
    acceleration: tuple[float, float]
    client: str


class Port(Protocol):
    """Where clients are heard and told."""

    def receive(self) -> Iterable[Setpoint | tuple[MessageRejected, str]]:
        """What came since the last call, in order: setpoints, and errors with the address of their sender."""

    def tell(self, tick: int, states: States, status: np.ndarray) -> None:
        """Tell the clients the states (N, 4) and the status (N,) of a tick."""


class Steering:
    """Setpoints of clients, each until its UAV is given back."""

    def __init__(
        self,
        port: Port,
        counters: Counters,
        note: Note,
        drop: Callable[[MessageRejected, str], None],
        clock: Callable[[], float],
    ) -> None:
        """
        Args:
            note: records the event of a UAV that is taken or given back.
            drop: counts a message that is rejected.
            clock: seconds, monotonic.
        """
        self.tell = port.tell
        self._port = port
        self._counters = counters
        self._note = note
        self._drop = drop
        self._clock = clock
        self._wanted: dict[int, tuple[float, Setpoint]] = {}  # the last setpoint of each UAV, and when it came
        self._steered: set[int] = set()  # UAVs, now

    def begin(self) -> None:
        """Discard what came before take-off."""
        for _ in self._port.receive():
            pass

    def replaced(self, commands: Plane, idle: Mask | None) -> Plane:
        """The commands (N, 2) of a tick, with setpoints in the rows of steered UAVs; `commands` stays as it is.

        `idle`: (N,), UAVs that cannot be steered; None for no UAV.
        """
        now = self._clock()
        for received in self._port.receive():
            if isinstance(received, Setpoint):
                self._wanted[received.uav] = now, received
            else:
                self._drop(*received)
        wanted = {
            uav: setpoint
            for uav, (since, setpoint) in self._wanted.items()
            if now - since <= SILENCE_S and (idle is None or not idle[uav])
        }
        for uav in sorted(self._steered - wanted.keys()):
            self._note("released", f"UAV {uav} flies by its controller again", [uav])
        for uav in sorted(wanted.keys() - self._steered):
            self._note("steered", f"UAV {uav} is steered by {wanted[uav].client}, not by its controller", [uav])
        self._steered = set(wanted)
        if not wanted:
            return commands
        self._counters.steered += len(wanted)
        flown = commands.copy()
        for uav, setpoint in wanted.items():
            flown[uav] = setpoint.acceleration
        return flown
