"""Which links the transmissions of a kind use in a tick, in the order in which they fade, are metered and delivered."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.wire.messages import FrameKind

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Links:
    """L links of a batch, of which K by radio; by source, then by target. They are shared: none is ever written to.

    ends: (L, 2) int32 [row of the batch, receiving UAV], as frames carry them. by_radio: (L,) bool; who sends to
    itself needs no radio. source, target: (K,) UAVs at the ends of the links by radio. pair: (K,), source · N + target.
    transmissions: how many are paid for. first: the first link by radio of each of them that has any.
    record: (K, 5) int32 [0, source, target, kind, 0].
    """

    ends: NDArray[np.int32]
    by_radio: NDArray[np.bool_]
    source: Indices
    target: Indices
    pair: Indices
    transmissions: int
    first: Indices
    record: NDArray[np.int32]

    @classmethod
    def of(
        cls, kind: FrameKind, sources: Indices, row: Indices, target: Indices, uavs: int, is_unicast: bool = False
    ) -> "Links":
        """Links from `sources[row]` to `target`, (L,) each, rows ascending; `uavs`: N. `is_unicast`: a link for each
        source, so that a source that is its own target transmits nothing."""
        ends = np.stack([row, target], axis=-1).astype(np.int32)
        by_radio = sources[row] != target
        row, target = row[by_radio], target[by_radio]
        source = sources[row]
        record = np.zeros((len(source), 5), dtype=np.int32)
        record[:, 1], record[:, 2], record[:, 3] = source, target, kind
        if is_unicast:
            transmissions, first = len(source), np.arange(len(source))
        else:
            transmissions, first = len(sources), np.flatnonzero(np.diff(row, prepend=-1))
        pair = source * uavs + target
        return cls(ends, by_radio, source, target, pair, transmissions, first, record)
