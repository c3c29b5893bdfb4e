"""Who takes part in a tick: neither lost nor put to sleep by the fault script."""

import numpy as np
from numpy.typing import NDArray

from meanflock.worldsim.admission import Admission
from meanflock.worldsim.faults import Script
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.members import Members
from meanflock.worldsim.reporter import Note, Reporter


class Awake:
    """uavs: (N,), who is; as a rule all of them, and then `everyone` is true."""

    def __init__(self, script: Script, flight: Flight, reporter: Reporter) -> None:
        self._has_faults, self._script, self._flight, self._reporter = (
            bool(flight.scenario.faults),
            script,
            flight,
            reporter,
        )
        self._all: NDArray[np.bool_] = np.ones(flight.scenario.uavs, dtype=bool)
        self.uavs = self._all

    @property
    def everyone(self) -> bool:
        """Whether nobody is lost or asleep, as far as that is known without looking."""
        return self.uavs is self._all

    def begin(self, tick: int, members: Members, admission: Admission, note: Note) -> None:
        """A tick begins: the fault script takes somebody out of the mission, or puts them to sleep."""
        flight, script = self._flight, self._script
        if not self._has_faults:
            self.uavs = ~flight.lost if flight.any_lost else self._all
            return
        self._reporter.events += script.events(tick)
        killed = script.killed(tick)
        flight.lose(killed, "lost", "killed by the fault script")
        lost = flight.lost
        for member in members.present if len(killed) else ():
            if np.isin(member.uavs, killed).any() and lost[member.uavs].all():
                admission.dismiss(member, "killed by the fault script")
        for _ in range(script.leaders_lost(tick)):
            if (leader := members.lead()) is not None:
                admission.dismiss(leader, "killed by the fault script")
                note("lost", f"{leader.name}: killed by the fault script")
        self.uavs = ~lost & ~script.paused(tick)
