"""Merger: the frames of all nodes in a tick, joined in an order that does not depend on the nodes."""

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np

from meanflock.channel.meter import Meter
from meanflock.federation.ledger import Ledger
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.state import Mask
from meanflock.swarm.wire.messages import FrameKind, Frames

Rejected: TypeAlias = tuple[MessageRejected, str]  # why, and whose frames


class FrameMerger:
    """Joins the frames of a tick by kind, broadcast number and form; drops those that may not be sent now."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger

    def merged(
        self, tick: int, sent: Iterable[Frames], awake: Mask, meter: Meter
    ) -> tuple[list[Frames], list[Rejected]]:
        """The joined frames of a tick, and those that may not be sent in it.

        Args:
            sent: one batch for each node, kind and broadcast, nodes in order of their UAVs.
            awake: (N,), UAVs that may send.
            meter: counts the bytes of the batches.
        """
        rejected: list[Rejected] = []
        alike: dict[tuple[int, int, str, int], list[Frames]] = {}
        for batch in sent:
            broadcast = batch.round if batch.kind == FrameKind.STATE else 0
            form = batch.kind, broadcast, batch.payload.dtype.str, batch.payload.shape[1]
            alike.setdefault(form, []).append(batch)
        # Sorted by form, so that the order does not depend on how UAVs are divided among processes.
        ordered = [alike[form] for form in sorted(alike)] if len(alike) > 1 else alike.values()
        joined = [frames for batches in ordered if (frames := self._joined(tick, batches, awake, meter, rejected))]
        return joined, rejected

    def _joined(
        self, tick: int, batches: list[Frames], awake: Mask, meter: Meter, rejected: list[Rejected]
    ) -> Frames | None:
        if batches[0].kind != FrameKind.STATE:
            batches = self._in_round(tick, batches, rejected)
        if b"\0" in awake.tobytes():  # faster than awake.all()
            batches = [part for batch in batches if (part := _by_awake(batch, awake)) is not None]
        for batch in batches:
            meter.wire(batch.kind, batch.wire_bytes)
        return _join(batches) if batches else None

    def _in_round(self, tick: int, batches: list[Frames], rejected: list[Rejected]) -> list[Frames]:
        """The batches that belong to a round that transmits in this tick, each UAV once."""
        accepted: list[Frames] = []
        senders: set[int] = set()
        for batch in batches:
            uavs = batch.source.tolist()
            error = self._ledger.round_error(batch, tick)
            if error is None and not senders.isdisjoint(uavs):
                error = MessageRejected("duplicate", f"two {batch.kind.name} frames of one UAV")
            if error is None:
                accepted.append(batch)
                senders.update(uavs)
            else:
                rejected.append((error, f"frames of UAV {uavs[0]}"))
        return accepted


def _by_awake(batch: Frames, awake: Mask) -> Frames | None:
    """The frames of UAVs that are awake; None if there are none."""
    sending = awake[batch.source]
    if sending.all():
        return batch
    return Frames(batch.kind, batch.round, batch.source[sending], batch.payload[sending]) if sending.any() else None


def _join(batches: list[Frames]) -> Frames:
    """One batch of all frames of batches of one kind and round."""
    if len(batches) == 1:
        return batches[0]
    source = np.concatenate([batch.source for batch in batches])
    payload = np.concatenate([batch.payload for batch in batches])
    if (source[1:] < source[:-1]).any():  # a node has UAVs of several groups, with others between them
        order = np.argsort(source, kind="stable")
        source, payload = source[order], payload[order]
    return Frames(batches[0].kind, batches[0].round, source, payload)
