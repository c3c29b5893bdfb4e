"""What nodes refuse of what others sent: uploads that are not averaged, and states that no UAV can have."""

from collections.abc import Callable

from meanflock.swarm.rounds import Rounds
from meanflock.swarm.wire.messages import Act
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.members import LEADER, Member


class Refused:
    """Counts and names them."""

    def __init__(self, rounds: Rounds, counters: Counters, note: Callable[[str, str], None]) -> None:
        self._rounds, self._counters, self._note = rounds, counters, note
        self._states: set[int] = set()  # in this tick

    def take(self, member: Member, act: Act) -> None:
        """What a node refused in a tick: a leader, and a head when it averages, uploads; all others states."""
        if member.role != LEADER and not self._rounds.relays(act.tick):
            self._states |= set(act.refused.tolist())
            return
        self._counters.uploads_refused += len(act.refused)
        self._note("refused", f"uploads of UAV {', '.join(map(str, act.refused))} were not averaged")

    def close(self) -> None:
        """The tick is over: UAVs whose states are not believed count once, however many nodes say so, and are named
        once a run.
        """
        if not self._states:
            return
        uavs, self._states = self._states, set()
        self._counters.states_refused += len(uavs)
        if new := sorted(uavs - self._counters.disbelieved):
            self._counters.disbelieved |= uavs
            self._note("refused", f"states of UAV {', '.join(map(str, new))} were not believed: no UAV can be so")
