"""The leader node: collects the uploads of a round, averages them when the round closes, broadcasts the result.

Where clusters have heads it collects their relays instead: a mean, and the number of models to weigh it by.
"""

import numpy as np
from numpy.typing import NDArray

from leader.aggregate import rule
from swarm import payload
from swarm.codec import expect
from swarm.errors import MessageRejected
from swarm.mean import pooled, refuse
from swarm.messages import OUTCOME_FLOATS, Act, FrameKind, Frames, Sense, Welcome
from swarm.relay import Relay
from swarm.rounds import Rounds
from swarm.scenario import decode

Floats = NDArray[np.float64]


class Leader:
    """What the leader does with a Sense; whoever carries the messages calls `act`."""

    def __init__(self, welcome: Welcome) -> None:
        self._scenario = decode(welcome.scenario)
        self._rounds = Rounds(self._scenario)
        self._up, self._down = payload.upload(self._scenario), payload.broadcast(self._scenario)
        federation = self._scenario.federation
        self._relay = Relay(self._scenario) if federation.clusters > 1 else None
        self._rule = pooled if self._relay is not None else rule(federation.aggregation, federation.tolerance)
        self.refused = 0  # uploads that were not averaged
        self._arrived: dict[int, dict[int, Floats]] = {}  # round → UAV → model, or relay

    def act(self, sense: Sense) -> Act:
        """One tick.

        Raises:
            MessageRejected: the Sense does not fit; nothing has changed.
        """
        for frames in sense.inbox:
            self._check(frames)

        # 1. Collect what arrived, by round and UAV; a second copy of the same upload changes nothing.
        for frames in sense.inbox:
            of_round = self._arrived.setdefault(frames.round, {})
            models = (self._relay or self._up).decode(frames.payload)
            for uav, model in zip(frames.source.tolist(), models, strict=True):
                of_round.setdefault(uav, model)
        # 2. When the round closes, refuse what cannot be a model, average and broadcast the rest; a round in which
        #    nothing is left is void.
        number = self._rounds.closes(sense.tick)
        arrived, refused = refuse(self._arrived.pop(number, {}) if number else {})
        self.refused += len(refused)
        outbox = (self._broadcast(number, arrived),) if arrived else ()
        return Act(sense.run, sense.tick, np.zeros((0, OUTCOME_FLOATS)), outbox=outbox, refused=tuple(refused))

    def _broadcast(self, number: int, arrived: dict[int, Floats]) -> Frames:
        source = np.array([self._scenario.federation.leader], dtype=np.int32)
        return Frames(FrameKind.GLOBAL, number, source, self._down.encode(self._rule(arrived)[None]))

    def _check(self, frames: Frames) -> None:
        if frames.kind != (FrameKind.UPLOAD if self._relay is None else FrameKind.RELAY):
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames are not for the leader")
        rows = len(expect("source", frames.source, (None,), np.int32))
        if self._relay is None:
            self._up.check(frames.payload, rows)
        else:
            self._relay.check(frames.source, frames.payload)
