"""Counters of the protocol, which world and crew share, and the spread of the models."""

import logging
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.errors import MessageRejected, printable
from meanflock.swarm.events import Dropped
from meanflock.swarm.stateful import Stateful

log = logging.getLogger("meanflock.world")

MAX_DROP_EVENTS = 100  # rejected messages in log and record; the counters count all
_AT_ONCE = 2**15  # weights whose deviations stay in a processor's cache


class Counters(Stateful):
    """Counters of the protocol, from take-off on, resumes included. Flight and radio have counters of their own.

    World and crew count here.

    Attributes:
        held: commands held over because they were late, in real time.
        deadline_misses: ticks with at least one such command.
        steered: commands replaced by those of clients; one for each UAV and tick.
        nodes_lost: nodes lost in flight.
        nodes_rejoined: nodes that joined in flight, in the place of a lost one or as a standby.
        uploads_refused: models that a node did not average.
        states_refused: implausible states that nodes received, one for each tick and sending UAV.
        implausible: the UAVs that sent them.
        world_s: wall-clock time that the world itself took: physics, encounters, radio, rounds.
        wall_s: wall-clock time flown before the run was resumed.
        spread: distance of the models from their mean when last measured; None if never.
        drops: messages that world and crew rejected, by reason.
        refused: messages that the bus kept from them, by reason; not in a checkpoint.
    """

    stored = (
        *("held", "deadline_misses", "steered", "nodes_lost", "nodes_rejoined", "uploads_refused", "states_refused"),
        *("implausible", "spread", "drops", "world_s"),
    )

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self.held = 0
        self.deadline_misses = 0
        self.steered = 0
        self.nodes_lost = 0
        self.nodes_rejoined = 0
        self.uploads_refused = 0
        self.states_refused = 0
        self.implausible: set[int] = set()
        self.world_s = 0.0
        self.wall_s = 0.0
        self.spread: float | None = None
        self.drops: Counter[str] = Counter()

    def drop(self, error: MessageRejected, where: str, tick: int, peer: str = "") -> Dropped | None:
        """Count a message that is rejected, and log the first ones.

        Args:
            where: its key or its sender. peer: name of the node that sent it.

        Returns:
            Its event; None if many were rejected before.
        """
        self.drops[error.reason] += 1
        if self.drops.total() > MAX_DROP_EVENTS:  # so that a flood fills neither log nor record
            return None
        where = printable(where)
        about = {"tick": tick, "peer": peer or where, "reason": error.reason}
        log.warning("dropped a message under %s: %s", where, error, extra=about)
        return Dropped(tick, where, error.reason, str(error))

    def late(self, commands: int) -> None:
        """Count the late commands of a tick in real time."""
        self.held += commands
        self.deadline_misses += commands > 0

    @property
    def dropped(self) -> Counter[str]:
        """Messages rejected by the world or the bus, by reason. Safe to read from any thread."""
        return self.drops.copy() + self.refused.copy()


def weight_spread(models: NDArray[np.float64]) -> float:
    """Root-mean-square distance of N models (N, W) from their mean."""
    count, weights = models.shape
    mean, squared = np.add.reduce(models, axis=0) / count, np.empty(count)
    rows = max(1, _AT_ONCE // weights)
    for first in range(0, count, rows):
        here = slice(first, first + rows)
        deviation = models[here] - mean
        deviation *= deviation
        np.add.reduce(deviation, axis=1, out=squared[here])
    return float(np.sqrt(np.add.reduce(squared) / count))
