"""Who leads the federation: what the elected leader is asked, and what a standby that takes over needs to know."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.worldsim import inbox
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.members import Members
from meanflock.worldsim.reporter import Note


class Leading:
    """The leaders of one run.

    uploads: what reached the leader in open rounds. aggregation: what the rule remembers, a record.
    """

    def __init__(self, scenario: Scenario, rounds: Rounds, note: Note) -> None:
        self.uploads = inbox.Uploads(FrameKind.RELAY if scenario.federation.clusters > 1 else FrameKind.UPLOAD)
        self.aggregation = b""
        self._rounds, self._note = rounds, note
        self._uav = scenario.federation.leader
        self._is_awake = True
        self._leads: str | None = None
        self._informed: str | None = None  # the leader that knows what the aggregation remembers

    def begin(self, members: Members) -> None:
        """The flight begins under the leader that is elected now."""
        self._leads = leader.name if (leader := members.lead()) is not None else None

    def receive(self, due: Iterable[Frames], awake: NDArray[np.bool_]) -> None:
        """Keeps the models that are delivered in this tick; they are lost if the leader's UAV is not `awake` (N,)."""
        self._is_awake = bool(awake[self._uav])
        if self._is_awake:
            self.uploads.receive(due)

    def ask(self, tick: int, members: Members, barrier: Barrier) -> None:
        """Asks the elected leader, if a round is open; again if another is elected before the tick is over. A leader
        whose UAV is lost or paused is not asked."""
        if not self._is_awake or not barrier.standing or not self._rounds.is_open(tick):
            return
        leader = members.lead()
        if leader is None:
            return
        if self._leads not in (None, leader.name):
            self._note("leader", f"{leader.name} takes over from {self._leads}")
        memory = self.aggregation if leader.name != self._informed else b""
        self._leads = self._informed = leader.name
        barrier.ask(leader, np.zeros((0, state.SIZE)), self.uploads.read(leader.name), memory=memory)

    def close(self, number: int, members: Members, counters: Counters) -> None:
        """Ends a round; one that was not averaged is counted as void."""
        self.uploads.close(number)
        if counters.averaged == number:
            return
        counters.rounds_void += 1
        why = "no model of another UAV was averaged"
        if not self._is_awake:
            why = f"UAV {self._uav}, which averages, is lost or paused"
        elif members.lead() is None:
            why = "there is no leader"
        self._note("void", f"round {number} is void: {why}")
