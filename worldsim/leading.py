"""Who leads the federation: what the elected leader is asked, and what a standby that takes over needs to know."""

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind
from meanflock.worldsim import inbox
from meanflock.worldsim.barrier import Barrier
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
        self._leads: str | None = None
        self._informed: str | None = None  # the leader that knows what the aggregation remembers

    def begin(self, members: Members) -> None:
        """The flight begins under the leader that is elected now."""
        self._leads = leader.name if (leader := members.lead()) is not None else None

    def ask(self, tick: int, members: Members, barrier: Barrier) -> None:
        """Asks the elected leader, if a round is open; again if another is elected before the tick is over."""
        if not barrier.standing or not self._rounds.is_open(tick):
            return
        leader = members.lead()
        if leader is None:
            if number := self._rounds.closes(tick):
                self._note("void", f"round {number} is void: there is no leader")
            return
        if self._leads not in (None, leader.name):
            self._note("leader", f"{leader.name} takes over from {self._leads}")
        memory = self.aggregation if leader.name != self._informed else b""
        self._leads = self._informed = leader.name
        barrier.ask(leader, np.zeros((0, state.SIZE)), self.uploads.read(leader.name), memory=memory)
