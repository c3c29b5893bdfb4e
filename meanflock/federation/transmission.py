"""Models in fragments on their way: what is transmitted over several ticks, and what UAVs received of a model."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.coding import Coding
from meanflock.federation.mailbox import links_of
from meanflock.federation.topology.base import Hop
from meanflock.swarm.state import Mask
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import Frames, frames_of


class Transmission:
    """The models that some UAVs transmit in fragments, over several ticks."""

    def __init__(self, frames: Frames, coding: Coding, wanted: Mask, sent: int = 0) -> None:
        """
        Args:
            frames: the models, of S UAVs.
            coding: how they are written, and cut.
            wanted: (S, F) fragments that are transmitted.
            sent: fragments of each whose turn is over.
        """
        assert coding.fragments is not None
        self._frames = frames
        self._coding = coding
        self._wanted = wanted
        self._per_tick = coding.fragments.cut.per_tick
        self._sent = sent

    @property
    def is_over(self) -> bool:
        """Returns whether all fragments had their turn."""
        return self._sent >= self._coding.count

    def next(self, awake: Mask) -> Frames | None:
        """The fragments whose turn it is, of the UAVs that are awake (N,); None for none."""
        turn = slice(self._sent, self._sent + self._per_tick)
        self._sent += self._per_tick
        frames = self._frames
        going = self._wanted[:, turn] & awake[frames.source][:, None]
        sender, place = np.nonzero(going)
        if not len(sender):
            return None
        rows = self._coding.on_air(frames.payload, turn)
        rows = rows.reshape(-1, rows.shape[2]) if going.all() else rows[sender, place]
        return Frames(frames.kind, frames.round, frames.source[sender], rows)

    def fields(self) -> list[Any]:
        """All of it."""
        return [self._frames, self._wanted, self._sent]

    @classmethod
    def of_fields(cls, fields: list[Any], hops: Iterable[Hop]) -> "Transmission":
        """The transmission with these `fields`, in one of the hops of a round."""
        models, wanted, sent = fields
        frames = frames_of(models)
        hop = next(hop for hop in hops if hop.label == frames.kind)
        return cls(frames, hop.coding, wanted, sent)


class Reception(Stateful):
    """Counts of the fragments of a global model that each UAV received."""

    stored = ("_sent", "_received")

    def __init__(self, uavs: int) -> None:
        self._sent = 0  # fragments that were broadcast
        self._received: NDArray[np.int64] = np.zeros(uavs, dtype=np.int64)  # of them, by UAV

    def send(self, frames: Frames) -> None:
        """Counts fragments that are broadcast."""
        self._sent += len(frames.source)

    def receive(self, frames: Frames, awake: Mask) -> None:
        """Counts fragments that arrive, at the UAVs that are awake (N,)."""
        self._received += np.bincount(links_of(frames)[:, 1], minlength=len(awake)) * awake

    def close(self, awake: Mask) -> tuple[int, int, int, int] | None:
        """Ends the count; None if nothing was sent.

        Returns:
            The number of fragments; of the UAVs that are awake (N,) how many received all, some and none of them.
        """
        sent, received = self._sent, self._received[awake]
        self._sent = 0
        self._received = np.zeros_like(self._received)
        if not sent:
            return None
        whole, some = int(np.count_nonzero(received >= sent)), int(np.count_nonzero(received))
        return sent, whole, some - whole, len(received) - some
