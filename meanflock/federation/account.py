"""Records of the rounds: an account of each that is open, and a hash of all models shared.

Flights whose federations did the same, to the last bit, have equal hashes.
"""

import hashlib
from collections.abc import Iterable, Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.plan import Plan
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import Frames, LinkColumn


class Account(msgspec.Struct, array_like=True):
    """Account of the uploads of one round.

    Attributes:
        participants: N_h. absent: those of them that were lost or paused.
        sent: UAVs that sent, ascending.
        copies: messages over links to other UAVs; a model in fragments is one message for each. arrived: those that
            were there when the round was averaged.
        received, late: UAVs whose upload, or a part of it, reached any UAV that averages in time, or later.
        refused: UAVs whose upload was received and could not be averaged.
        earlier: late uploads of the round before, which count in this one.
        retries: fragments of uploads that were transmitted again.
        ticks: of each upload of `sent`, ticks from the opening until its last part arrived or will; -1: nothing did.
        parts: of each upload of `sent`, fragments that were there when the round was averaged.
        waits, fails: whether the aggregation rule waits for more models, or failed, at an agent's UAV that averages.
    """

    participants: int
    absent: int
    sent: list[int]
    copies: int = 0
    arrived: int = 0
    earlier: int = 0
    retries: int = 0
    ticks: list[int] = []
    parts: list[int] = []
    waits: bool = False
    fails: bool = False

    def __post_init__(self) -> None:
        """Begin with nothing of each upload."""
        self.ticks = self.ticks or [-1] * len(self.sent)
        self.parts = self.parts or [0] * len(self.sent)

    received: set[int] = set()
    late: set[int] = set()
    refused: set[int] = set()

    def transmit(
        self, links: NDArray[np.int32], rows: NDArray[np.intp], ticks: NDArray[np.intp], is_late: NDArray[np.bool_]
    ) -> None:
        """Counts uploads on the air over links (K, 7): `rows` (K,) messages of each, the `ticks` (K,) after the opening
        in which they arrive, and which of them are late."""
        self.copies += int(rows.sum())
        self.late.update(links[is_late, LinkColumn.SOURCE].tolist())
        arrive = links[:, LinkColumn.DELIVERED] > 0
        place = np.searchsorted(self.sent, links[arrive, LinkColumn.SOURCE])
        latest = np.array(self.ticks)
        np.maximum.at(latest, place, ticks[arrive])
        self.ticks = latest.tolist()

    def receive(self, parts: Mapping[int, int], copies: int) -> None:
        """Counts the mail of this round that is there when it is averaged: fragments by UAV, and messages."""
        self.parts = [parts.get(uav, 0) for uav in self.sent]
        self.received.update(parts)
        self.arrived += copies


class ModelsHash(Stateful):
    """Hash of the global models, as they are coded, in the order in which they are broadcast.

    Where no global model goes by radio, as with the topology `neighbours`, the uploads count in their place.
    """

    stored = ("digest",)

    def __init__(self, plan: Plan) -> None:
        by_radio = [hop for hop in plan.hops if not hop.is_local]
        self._label = by_radio[-1].label if by_radio else None
        self._codec = by_radio[-1].codec if by_radio else None
        self.digest = b""  # after the models so far; empty before the first

    @property
    def hexdigest(self) -> str | None:
        """The hash as text; None if no model was sent."""
        return self.digest.hex() or None

    def add(self, frames: Iterable[Frames]) -> None:
        """Add the models among the frames of a tick, sources ascending."""
        for batch in frames:
            if batch.kind == self._label and self._codec is not None:
                source, payload = self._codec.whole(batch.source, batch.payload)
                form = f"{batch.round} {payload.dtype.str} {payload.shape}".encode()
                whole = hashlib.sha256(self.digest + form + source.astype("<i4").tobytes())
                whole.update(np.ascontiguousarray(payload).data)
                self.digest = whole.digest()
