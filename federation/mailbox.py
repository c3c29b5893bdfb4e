"""Mailboxes: the models that the world keeps for the UAVs that average, until the round is averaged."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.topology.base import Hop
from meanflock.swarm.state import Mask
from meanflock.swarm.wire.messages import FrameKind, Frames

Indices: TypeAlias = NDArray[np.intp]


class Mailbox:
    """The mail of all UAVs that average for one hop, until the round is averaged.

    A node reads each frame for its UAVs once. A node that takes UAVs over reads all that there is for them.

    Attributes:
        addressed: (N,) UAVs that mail was sent to since the box was last closed, delivered or not.
    """

    def __init__(self, uavs: int) -> None:
        self._frames: list[Frames] = []
        self._read = np.zeros(uavs, dtype=np.intp)  # of these frames, for each UAV, by this node:
        self._reader = np.full(uavs, "", dtype=object)
        self.addressed = np.zeros(uavs, dtype=bool)

    def put(self, frames: Frames, awake: Mask) -> None:
        """Adds frames for the UAVs that are awake (N,)."""
        target = links_of(frames)[:, 1]
        self.addressed[target] = True
        received = awake[target]
        if received.any():
            self._frames.append(_picked(frames, received))

    def read(self, reader: str, uavs: Indices) -> list[Frames]:
        """The frames for some UAVs (M,) that a node, by name, has not read yet."""
        begun = np.where(self._reader[uavs] == reader, self._read[uavs], 0)
        self._reader[uavs], self._read[uavs] = reader, len(self._frames)
        found = []
        for first in np.unique(begun).tolist():
            reading = np.zeros(len(self._read), dtype=bool)
            reading[uavs[begun == first]] = True
            for frames in self._frames[first:]:
                here = reading[links_of(frames)[:, 1]]
                if here.any():
                    found.append(frames if here.all() else _picked(frames, here))
        return found

    def fragments(self, hop: Hop, uav: int) -> Mask:
        """The fragments that a UAV averages and sends in a hop, (F,): those that arrived; in a last hop from others."""
        assert hop.mail is not None
        cut = hop.mail.coding.fragments
        arrived = np.zeros(hop.coding.count, dtype=bool)
        for frames in self._frames:
            links = links_of(frames)
            here = links[links[:, 1] == uav, 0]
            if hop.is_last and hop.mail.mail is None:
                here = here[frames.source[here] != uav]
            if cut is None:
                arrived |= len(here) > 0
            else:
                arrived[cut.numbers(frames.payload)[here]] = True
        return arrived

    def arrived(self, number: int) -> tuple[list[int], int]:
        """The UAVs whose models of a round arrived, or parts of them, and how many messages of others did."""
        has_arrived = np.zeros(len(self._read), dtype=bool)
        copies = 0
        for frames in self._frames:
            if frames.round == number:
                row, target = links_of(frames).T
                source = frames.source[row]
                has_arrived[source] = True
                copies += int(np.count_nonzero(source != target))
        return np.flatnonzero(has_arrived).tolist(), copies

    def receivers(self, number: int) -> Mask:
        """The UAVs that a model of a round was delivered to, (N,)."""
        received = np.zeros(len(self._read), dtype=bool)
        for frames in self._frames:
            if frames.round == number:
                received[links_of(frames)[:, 1]] = True
        return received

    def close(self, number: int) -> None:
        """Drops the mail of a round and of all before it."""
        later = [place for place, frames in enumerate(self._frames) if frames.round > number]
        self._read = np.searchsorted(later, self._read)
        self._frames = [self._frames[place] for place in later]
        self.addressed[:] = False

    def snapshot(self) -> list[Any]:
        """The mail, for `restore`; the nodes that average after it read everything."""
        frames = [[int(f.kind), f.round, f.source, f.payload, f.links, f.slots] for f in self._frames]
        return [np.flatnonzero(self.addressed).astype(np.int32), frames]

    def restore(self, snapshot: list[Any]) -> None:
        """Goes on with the mail of a snapshot."""
        addressed, frames = snapshot
        self.addressed[:] = False
        self.addressed[addressed] = True
        self._frames = [Frames(FrameKind(kind), *fields) for kind, *fields in frames]
        self._read[:], self._reader[:] = 0, ""


def links_of(frames: Frames) -> NDArray[np.int32]:
    """The links (K, 2) of frames that the radio delivered."""
    assert frames.links is not None
    return frames.links


def only(frames: Frames, links: NDArray[np.int32], slots: NDArray[np.int32] | None = None) -> Frames:
    """Frames reduced to some of their links (K, 2), which took `slots` (K,)."""
    used = np.zeros(len(frames.source), dtype=bool)
    used[links[:, 0]] = True
    if len(used) == 1 or np.logical_and.reduce(used):
        if links is frames.links:
            return frames
        return Frames(frames.kind, frames.round, frames.source, frames.payload, links, slots)
    place = np.cumsum(used, dtype=np.int32) - 1  # of a row among those that are used
    renumbered = np.stack([place[links[:, 0]], links[:, 1]], axis=-1)
    rows = used.nonzero()[0]
    return Frames(frames.kind, frames.round, frames.source[rows], frames.payload.take(rows, axis=0), renumbered, slots)


def _picked(frames: Frames, picked: Mask) -> Frames:
    """Frames reduced to the links that are `picked` (K,)."""
    return only(frames, links_of(frames)[picked], None if frames.slots is None else frames.slots[picked])
