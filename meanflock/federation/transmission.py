"""Models on their way: what is transmitted over several ticks and again, and what UAVs received of a global model."""

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.mailbox import links_of, picked
from meanflock.federation.topology.base import Hop
from meanflock.swarm.state import Mask
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import FrameKind, Frames, LinkColumn, frames_of

_ATTEMPT = ("_turn", "_left", "_due", "_attempt_ticks", "_is_first", "again")  # in a checkpoint, in this order


class Acknowledge(Protocol):
    """Transmits acknowledgements, billed as the models are, and returns the mask (K,) of those that arrive."""

    def __call__(self, kind: FrameKind, bits: int, source: NDArray[np.intp], target: NDArray[np.intp]) -> Mask: ...


class Transmission:
    """The models that some UAVs transmit in a hop, fragment by fragment, and again where no acknowledgement came.

    Attributes:
        hop: the hop. frames: all fragments, R of them. again: number of fragments that were transmitted again.
    """

    def __init__(self, hop: Hop, frames: Frames, wanted: Mask, tick: int, attempt_ticks: int, retries: int) -> None:
        """
        Args:
            wanted: (R,) fragments that are transmitted.
            tick: of the first turn. attempt_ticks: until all fragments of an attempt have arrived or are lost.
            retries: attempts after the first one.
        """
        self.hop, self.frames = hop, frames
        self.again = 0
        self._places = hop.codec.places(frames.payload)
        self._wanted = wanted
        self._own = np.zeros(len(frames.source), dtype=bool)  # (R,) fragments that their senders have received
        self._turn = 0  # first place of the next turn
        self._left, self._due, self._attempt_ticks = retries, tick + attempt_ticks, attempt_ticks
        self._is_first = True  # attempt
        self._pairs = np.zeros((0, 2), dtype=np.intp)  # (P, 2) sources and targets of links that were used, ascending
        self._reached = np.zeros((0, hop.codec.count), dtype=bool)  # (P, F) fragments that arrived
        self._acknowledged = np.zeros((0, hop.codec.count), dtype=bool)  # (P, F) fragments that were acknowledged

    @property
    def _repeats(self) -> bool:
        """Returns whether anything may be, or was, transmitted again."""
        return self._left > 0 or not self._is_first

    def is_over(self, tick: int) -> bool:
        """Returns whether nothing is transmitted any more, and nothing that was transmitted again is on its way."""
        is_sent = self._turn >= self.hop.codec.count and not self._left
        return is_sent and (tick >= self._due or not self._repeats)

    def next(self, tick: int, awake: Mask, acknowledge: Acknowledge) -> Frames | None:
        """The fragments whose turn it is, of the UAVs that are awake (N,); None for none."""
        if tick == self._due and self._left:
            self._left -= 1
            self._due += self._attempt_ticks
            self._acknowledge(awake, acknowledge)
            self._is_first = False
            if self._wanted.any():
                self._turn = 0
            else:
                self._left = 0
        cut, frames = self.hop.codec.cut, self.frames
        end = self._turn + (1 if cut is None else cut.per_tick)
        going = self._wanted & (self._places >= self._turn) & (self._places < end) & awake[frames.source]
        self._turn = end
        if not going.any():
            return None
        if not self._is_first:
            self.again += int(np.count_nonzero(going))
        if going.all():
            return frames
        return Frames(frames.kind, frames.round, frames.source[going], frames.payload[going])

    def follow(self, links: NDArray[np.int32]) -> None:
        """Takes notice of the links (K, 7) over which it was transmitted in this tick; only if anything repeats."""
        if not self._repeats:
            return
        ends = [LinkColumn.SOURCE, LinkColumn.TARGET]
        used = links[links[:, LinkColumn.KIND] == self.hop.label][:, ends].astype(np.intp)
        pairs = np.unique(np.concatenate([self._pairs, used[np.isin(used[:, 0], self.frames.source)]]), axis=0)
        if len(pairs) > len(self._pairs):
            place = _places(pairs, self._pairs)
            tables = []
            for table in (self._reached, self._acknowledged):
                tables.append(np.zeros((len(pairs), table.shape[1]), dtype=bool))
                tables[-1][place] = table
            self._pairs, (self._reached, self._acknowledged) = pairs, tables

    def new(self, frames: Frames, awake: Mask) -> Frames | None:
        """Frames of this transmission that arrive, without those that their UAVs have already; None for none."""
        if not len(self._pairs) or (frames.kind, frames.round) != (self.frames.kind, self.frames.round):
            return frames
        links = links_of(frames)
        row, target = links.T
        source, fragment = frames.source[row], self.hop.codec.places(frames.payload)[row]
        by_radio = source != target
        pair = _places(self._pairs, np.stack([source, target], axis=-1)[by_radio].astype(np.intp))
        own = self._rows(source[~by_radio], fragment[~by_radio])
        is_new = np.ones(len(links), dtype=bool)
        is_new[by_radio] = ~self._reached[pair, fragment[by_radio]]
        is_new[~by_radio] = ~self._own[own]
        hears = awake[target[by_radio]]
        self._reached[pair[hears], fragment[by_radio][hears]] = True
        self._own[own[awake[target[~by_radio]]]] = True
        return picked(frames, is_new)

    def fields(self) -> list[Any]:
        """All of it."""
        attempt = [getattr(self, name) for name in _ATTEMPT]
        return [self.frames, self._wanted, attempt, self._pairs, self._own, self._reached, self._acknowledged]

    @classmethod
    def of_fields(cls, fields: list[Any], hops: Iterable[Hop]) -> "Transmission":
        """The transmission with these `fields`, in one of the hops of a round."""
        models, wanted, attempt, pairs, *masks = fields
        frames = frames_of(models)
        restored = cls(next(hop for hop in hops if hop.label == frames.kind), frames, wanted.astype(bool), 0, 0, 0)
        for name, value in zip(_ATTEMPT, attempt, strict=True):
            setattr(restored, name, value)
        restored._pairs = pairs.astype(np.intp)
        restored._own, restored._reached, restored._acknowledged = (mask.astype(bool) for mask in masks)
        return restored

    def _rows(self, source: NDArray[np.integer], fragment: NDArray[np.intp]) -> NDArray[np.intp]:
        """The rows of some fragments."""
        count = self.hop.codec.count
        every = self.frames.source.astype(np.intp) * count + self._places
        return every.searchsorted(source.astype(np.intp) * count + fragment)

    def _acknowledge(self, awake: Mask, acknowledge: Acknowledge) -> None:
        """Lets every UAV that received something say what; fragments that a sender has no word of are wanted again."""
        source, target = self._pairs.T
        says = (self._reached & ~self._acknowledged).any(axis=1) & awake[target]
        if says.any():
            order = np.lexsort((source[says], target[says]))  # the UAVs that answer, ascending
            answering = np.flatnonzero(says)[order]
            bits = self.hop.codec.acknowledgement_bits
            arrived = answering[acknowledge(self.hop.label, bits, target[answering], source[answering])]
            self._acknowledged[arrived] |= self._reached[arrived]
        missing = np.zeros((len(awake), self._acknowledged.shape[1]), dtype=bool)
        np.logical_or.at(missing, source, ~self._acknowledged)
        self._wanted = self._wanted & missing[self.frames.source, self._places]


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


def _places(pairs: NDArray[np.intp], wanted: NDArray[np.intp]) -> NDArray[np.intp]:
    """The places of some pairs among pairs in ascending order, all of which are there."""
    scale = 2**32
    return (pairs[:, 0] * scale + pairs[:, 1]).searchsorted(wanted[:, 0] * scale + wanted[:, 1])
