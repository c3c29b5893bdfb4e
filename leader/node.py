"""The leader node: a process around the leader's part in the rounds."""

import numpy as np

from meanflock.federation.plan import plan_of
from meanflock.federation.rounds import Rounds
from meanflock.swarm.events.nodes import Problem
from meanflock.swarm.scenario import decode
from meanflock.swarm.state import NO_UAV
from meanflock.swarm.wire.messages import Act, Sense, Welcome


class Leader:
    """Answers each Sense with an Act; the client that carries the messages calls `act`."""

    def __init__(self, welcome: Welcome) -> None:
        """Raises BadInput if `init` of the aggregation rule fails."""
        self.problems: list[Problem] = []  # texts for the world that were not sent yet
        plan = plan_of(decode(welcome.scenario))
        self._no_commands = np.zeros((0, plan.scenario.dimensions))
        self._rounds = Rounds(plan, "leader", NO_UAV, self.problems)

    def act(self, sense: Sense) -> Act:
        """Compute one tick.

        Raises:
            MessageRejected: the Sense does not fit; nothing has changed.
        """
        for frames in sense.inbox:
            self._rounds.check(frames)
        if sense.memory:
            self._rounds.take_over(sense.memory)
        for frames in sense.inbox:
            self._rounds.receive(frames, sense.tick)
        outbox, refused = self._rounds.act(sense.tick)
        return Act(
            sense.run,
            sense.tick,
            self._no_commands,
            refused_uploads=np.array(refused, dtype=np.int32),
            memory=self._rounds.rule_record,
            outbox=tuple(outbox),
        )
