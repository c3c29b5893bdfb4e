"""What reaches a node: the part of the delivered frames that is for it, and what an averager needs of an open round."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.ascending import contains
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.worldsim.members import Member

_AVERAGED = (FrameKind.UPLOAD, FrameKind.RELAY)  # these are kept until they are


def of_agents(due: Iterable[Frames], awake: NDArray[np.bool_]) -> list[Frames]:
    """What is not kept for who averages, over links to UAVs that are `awake` (N,)."""
    arrived = [batch for batch in due if batch.kind not in _AVERAGED and batch.links is not None]
    if arrived and not awake.all():
        arrived = [only(batch, batch.links[awake[batch.links[:, 1]]]) for batch in arrived if batch.links is not None]
    return [batch for batch in arrived if batch.links is not None and len(batch.links)]


def of_agent(member: Member, arrived: Iterable[Frames], uavs: int) -> tuple[Frames, ...]:
    """Of what arrived at `uavs` UAVs, the links to an agent's, and the payloads they need."""
    own = []
    for batch in arrived:
        assert batch.links is not None
        links, targets = batch.links, batch.links[:, 1]
        if member.rows < uavs:
            links = links[targets == member.uavs[0] if member.rows == 1 else contains(member.uavs, targets)]
        if len(links):
            own.append(only(batch, links))
    return tuple(own)


class Uploads:
    """What a UAV that averages has received in open rounds. A node hears each once, a new one hears all."""

    def __init__(self, kind: FrameKind = FrameKind.UPLOAD) -> None:
        """`kind`: of the frames it averages."""
        self._kind = kind
        self._kept: list[Frames] = []
        self._seen = 0  # of them, to whom:
        self._reader: str | None = None

    def receive(self, due: Iterable[Frames]) -> None:
        """Keeps what is delivered in this tick."""
        for batch in due:
            if batch.kind == self._kind and batch.links is not None and len(batch.links):
                all_came = len(batch.links) == len(batch.source)  # there is a link for each of these
                self._kept.append(batch if all_came else only(batch, batch.links))

    def read(self, reader: str) -> tuple[Frames, ...]:
        """What a node has not heard yet."""
        if reader != self._reader:
            self._reader, self._seen = reader, 0
        unread = tuple(self._kept[self._seen :])
        self._seen = len(self._kept)
        return unread

    def close(self, number: int) -> None:
        """A round is over, averaged or void."""
        seen = self._kept[: self._seen]
        self._kept = [frames for frames in self._kept if frames.round > number]
        self._seen = sum(frames.round > number for frames in seen)

    def snapshot(self) -> list[Any]:
        """What is kept; whoever averages after `restore` hears it all."""
        return [[f.round, f.source, f.payload, f.links] for f in self._kept]

    def restore(self, snapshot: list[Any]) -> None:
        """Goes on with what a snapshot kept."""
        self._kept = [Frames(self._kind, *fields) for fields in snapshot]
        self._seen, self._reader = 0, None


def only(batch: Frames, links: NDArray[np.int32]) -> Frames:
    """The batch cut down to some of its links."""
    used = np.zeros(len(batch.source), dtype=bool)
    used[links[:, 0]] = True
    if len(used) == 1 or np.logical_and.reduce(used):
        return batch if links is batch.links else Frames(batch.kind, batch.round, batch.source, batch.payload, links)
    place = np.cumsum(used, dtype=np.int32) - 1  # of a row among those that are used
    renumbered = np.stack([place[links[:, 0]], links[:, 1]], axis=-1)
    return Frames(batch.kind, batch.round, batch.source[used], batch.payload[used], renumbered)
