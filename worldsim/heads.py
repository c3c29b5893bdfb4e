"""What the heads of clusters have received and not yet handed on, and which clusters a round goes on without."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.ascending import contains
from meanflock.swarm.clusters import Clusters
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.worldsim.inbox import Uploads, only
from meanflock.worldsim.members import Member


class Heads:
    """The uploads of a round by head, until its relay; none where the leader averages alone.

    The node that holds a head averages, but the world keeps what it has told it: another that takes the UAV over in
    the middle of a round hears it all, as does one that goes on from a checkpoint.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._heads = Clusters(scenario).heads if scenario.federation.clusters > 1 else np.zeros(0, dtype=np.intp)
        self._of = {head: Uploads() for head in self._heads.tolist()}
        self._sent_to: set[int] = set()  # of them, in the round that is open; they need not have heard it

    def receive(self, due: Iterable[Frames], awake: NDArray[np.bool_]) -> None:
        """Keeps what is delivered in this tick to heads that are `awake` (N,)."""
        for batch in due:
            if self._of and batch.kind == FrameKind.UPLOAD and batch.links is not None:
                for head in np.unique(batch.links[:, 1]).tolist():
                    self._sent_to.add(head)
                    if awake[head]:
                        self._of[head].receive([only(batch, batch.links[batch.links[:, 1] == head])])

    @property
    def any_sent(self) -> bool:
        """Whether anything was sent to any of them in the round that is open."""
        return bool(self._sent_to)

    def read(self, member: Member) -> tuple[Frames, ...]:
        """What the heads a node holds have received and it has not heard yet."""
        held = self._heads[contains(member.uavs, self._heads)].tolist()
        return tuple(frames for head in held for frames in self._of[head].read(member.name))

    def relayed(self, number: int, frames: Iterable[Frames], links: NDArray[np.int32]) -> Iterator[str]:
        """A round's relays are sent, as `frames` over `links` (K, 5); says which clusters do not reach the leader."""
        sent = {uav for batch in frames if batch.kind == FrameKind.RELAY for uav in batch.source.tolist()}
        lost = set(links[(links[:, 3] == FrameKind.RELAY) & (links[:, 4] < 0), 1].tolist())
        for head, uploads in self._of.items():
            if head in lost or head in self._sent_to - sent:
                why = "its relay is lost" if head in lost else "its head is silent"
                yield f"round {number} goes on without the cluster of UAV {head}: {why}"
            uploads.close(number)
        self._sent_to = set()

    def snapshot(self) -> list[Any]:
        """What is kept, by head."""
        return [[head, head in self._sent_to, uploads.snapshot()] for head, uploads in self._of.items()]

    def restore(self, snapshot: list[Any]) -> None:
        """Goes on with what a snapshot kept."""
        for head, sent_to, kept in snapshot:
            self._of[head].restore(kept)
            self._sent_to |= {head} if sent_to else set()
