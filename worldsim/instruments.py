"""What can be read of a run while it flies, from any thread. Everything is live: read it, change nothing."""

from collections.abc import Callable, Set
from dataclasses import dataclass

from meanflock.channel.meter import Meter
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.durations import Durations
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.members import Members
from meanflock.worldsim.outbox import Outbox


@dataclass(frozen=True)
class Instruments:
    """The parts of a world somebody may look at."""

    run: str
    mode: str
    flight: Flight
    meter: Meter
    counters: Counters
    members: Members
    listeners: Set[str]  # ground stations that are there
    outbox: Outbox
    waits: Durations  # at the barrier: from the last question of a tick to the last answer
    ticks: Durations  # of the world, all six steps
    wall_s: Callable[[], float]  # flown so far, from the first tick on
