"""Mailboxes: the models that the world keeps for the UAVs that average, until the round is averaged."""

from collections.abc import Iterable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.federation.topology.base import Hop, Role
from meanflock.swarm.state import Mask, contains
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import Frames, frames_of

Indices: TypeAlias = NDArray[np.intp]


class Letter(NamedTuple):
    """Frames that wait until a hop averages them.

    number: place in the order in which all mail of a flight came, from 1. hop: the hop that averages them.
    """

    number: int
    hop: Hop
    frames: Frames


class Mailbox(Stateful):
    """The mail of all UAVs that average for one hop, until the round is averaged.

    Attributes:
        hop: the hop that averages. letters: the mail, oldest first.
        addressed: (N,) UAVs that mail was sent to since the box was last closed, delivered or not.
    """

    stored = ("addressed", "mail")

    def __init__(self, hop: Hop, uavs: int) -> None:
        self.letters: list[Letter] = []
        self.addressed = np.zeros(uavs, dtype=bool)
        self.hop = hop

    def put(self, number: int, frames: Frames, awake: Mask) -> None:
        """Adds frames under a number for the UAVs that are awake (N,)."""
        target = links_of(frames)[:, 1]
        self.addressed[target] = True
        if (received := picked(frames, awake[target])) is not None:
            self.letters.append(Letter(number, self.hop, received))

    def fragments(self, uav: int) -> Mask:
        """The fragments that a UAV averages and sends, (F,): those that arrived; in a last hop from others."""
        hop = self.hop
        assert hop.mail is not None
        arrived = np.zeros(hop.codec.count, dtype=bool)
        for _, _, frames in self.letters:
            links = links_of(frames)
            here = links[links[:, 1] == uav, 0]
            if hop.is_last and hop.averages == "models":
                here = here[frames.source[here] != uav]
            arrived[hop.mail.codec.places(frames.payload)[here]] = True
        return arrived

    def arrived(self, number: int) -> tuple[dict[int, int], int]:
        """The UAVs whose models of a round arrived, with the fragments of each that any UAV has, and how many messages
        of others arrived."""
        assert self.hop.mail is not None
        codec = self.hop.mail.codec
        found = np.zeros((len(self.addressed), codec.count), dtype=bool)
        copies = 0
        for _, _, frames in self.letters:
            if frames.round == number:
                row, target = links_of(frames).T
                source = frames.source[row]
                found[source, codec.places(frames.payload)[row]] = True
                copies += int(np.count_nonzero(source != target))
        parts = found.sum(axis=1)
        uavs = np.flatnonzero(parts)
        return dict(zip(uavs.tolist(), parts[uavs].tolist(), strict=True)), copies

    def receivers(self, number: int) -> Mask:
        """The UAVs that a model of a round was delivered to, (N,)."""
        received = np.zeros(len(self.addressed), dtype=bool)
        for _, _, frames in self.letters:
            if frames.round == number:
                received[links_of(frames)[:, 1]] = True
        return received

    def close(self, number: int) -> None:
        """Drops the mail of a round and of all before it."""
        self.letters = [letter for letter in self.letters if letter.frames.round > number]
        self.addressed[:] = False

    @property
    def mail(self) -> list[tuple[int, Any]]:
        """Number and frames of each letter."""
        return [(number, frames) for number, _, frames in self.letters]

    @mail.setter
    def mail(self, stored: list[tuple[int, Any]]) -> None:
        self.letters = [Letter(number, self.hop, frames_of(fields)) for number, fields in stored]


def mail_for(letters: Iterable[Letter], role: Role, uavs: Indices | None = None, after: int = 0) -> tuple[Frames, ...]:
    """Mail for a node of some role and its `uavs` (M,), each batch with its receipt.

    Args:
        uavs: None: all UAVs. after: number of the last letter that the node has read; 0 for none.
    """
    found: list[Frames] = []
    for number, hop, frames in letters:
        if number <= after or hop.role != role:
            continue
        averaging = hop.senders if uavs is None else uavs[contains(hop.senders, uavs)]
        if (part := picked(frames, np.isin(links_of(frames)[:, 1], averaging))) is not None:
            found += [part, _receipt(part)]
    return tuple(found)


def _receipt(frames: Frames) -> Frames:
    """The slots that frames of models were on the air, a row for each link."""
    assert frames.slots is not None
    row, target = links_of(frames).T
    links = np.stack([np.arange(len(row), dtype=np.int32), target], axis=-1)
    return Frames(frames.kind, frames.round, frames.source[row], frames.slots[:, None], links)


def links_of(frames: Frames) -> NDArray[np.int32]:
    """The links (K, 2) of frames that the radio delivered."""
    assert frames.links is not None
    return frames.links


def picked(frames: Frames, chosen: Mask | None = None) -> Frames | None:
    """Frames reduced to some links, and to the rows that these use; not copied if all stay, None if no link stays.

    `chosen`: (K,), the links that stay; None: all.
    """
    links = links_of(frames)
    staying, used = np.empty_like(links), np.empty(len(frames.source), dtype=np.intp)
    count, rows = kernels.pick(links, chosen, staying, used)
    if not count:
        return None
    if count == len(links) and rows == len(used):
        return frames
    slots = frames.slots if frames.slots is None or chosen is None else frames.slots[chosen]
    source, payload = frames.source, frames.payload
    if rows < len(used):
        source, payload = source[used[:rows]], payload.take(used[:rows], axis=0)
    return Frames(frames.kind, frames.round, source, payload, staying[:count], slots)
