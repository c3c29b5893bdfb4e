"""Payload that the UAVs of each group of a flight send, by kind of traffic."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import FrameKind

_KINDS = tuple(FrameKind)


class GroupBills(Stateful):
    """Payload bits of G groups since take-off.

    Attributes:
        sent: (K, G), bits that the UAVs of a group sent, a row for each kind in the order of `FrameKind`.
        marked: (K, G), the same at the last arrival of a UAV of the group; 0 before the first one.
    """

    stored = ("sent", "marked")

    def __init__(self, counts: Sequence[int], stations: int) -> None:
        """`counts`: number of UAVs of each group, in their order. Stations belong to no group."""
        self._groups = len(counts)
        self._group = np.repeat(np.arange(self._groups + 1), [*counts, stations])  # (N + B,), of each node
        self.sent = np.zeros((len(_KINDS), self._groups), dtype=np.int64)
        self.marked = np.zeros_like(self.sent)

    def add(self, kind: FrameKind, payload_bits: int, senders: NDArray[np.intp]) -> None:
        """Adds transmissions of so many bits each, one for each of `senders` (T,)."""
        counts = np.bincount(self._group[senders], minlength=self._groups + 1)
        self.sent[_KINDS.index(kind)] += payload_bits * counts[: self._groups]

    def mark(self, uavs: NDArray[np.intp]) -> None:
        """Stores the bits of the groups of some UAVs in `marked`."""
        groups = np.unique(self._group[uavs])
        self.marked[:, groups] = self.sent[:, groups]

    def until(self, group: int, *, arrival: bool) -> dict[FrameKind, int]:
        """Bits of a group by kind, until its last arrival or until now."""
        return dict(zip(_KINDS, (self.marked if arrival else self.sent)[:, group].tolist(), strict=True))
