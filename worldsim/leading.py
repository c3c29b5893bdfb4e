"""Leading: which leader node is asked, and what a standby that takes over needs to know."""

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.post import Post
from meanflock.swarm import state
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.members import Members
from meanflock.worldsim.reporter import Note


class Leading:
    """The leader nodes of one run, one of which leads."""

    def __init__(self, post: Post, note: Note) -> None:
        self._post, self._note = post, note
        self._leads: str | None = None
        self._informed: str | None = None  # the leader that has the state of the aggregation rule

    def begin(self, members: Members) -> None:
        """The flight begins under the leader that is elected now."""
        self._leads = leader.name if (leader := members.lead()) is not None else None

    def ask(self, tick: int, members: Members, barrier: Barrier, awake: NDArray[np.bool_]) -> None:
        """Asks the elected leader, if a round needs it; again if another is elected before the tick is over."""
        if not barrier.standing or not self._post.leader_is_due(tick, awake):
            return
        leader = members.lead()
        if leader is None:
            return
        if self._leads not in (None, leader.name):
            self._note("leader", f"{leader.name} takes over from {self._leads}")
        memory = self._post.rule_record if leader.name != self._informed else b""
        self._leads = self._informed = leader.name
        barrier.ask(leader, np.zeros((0, state.SIZE)), self._post.mail("leader", leader.name), memory=memory)
