"""Backhaul: the wire between stations, over which models go to the station where the leader averages, and back."""

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.mailbox import links_of, picked
from meanflock.federation.plan import Plan
from meanflock.swarm.state import Mask
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import FrameKind, Frames


class Backhaul(Stateful):
    """Carries models between stations at once, without losses, and counts them.

    Attributes:
        messages: models, or fragments of them, that went from one station to another. bits: of these.
    """

    stored = ("messages", "bits")

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._kinds = {hop.label for hop in plan.hops if hop.by_station}
        self.messages = 0
        self.bits = 0

    def gathered(self, due: Sequence[Frames], present: Mask) -> Sequence[Frames]:
        """The frames that arrive now, uploads to other stations at the one where the leader averages.

        Args:
            present: (N + B,), nodes that are neither lost nor paused; what arrives at others is lost.
        """
        if not self._kinds:
            return due
        return [part for frames in due if (part := self._gathered(frames, present)) is not None]

    def _gathered(self, frames: Frames, present: Mask) -> Frames | None:
        if frames.kind not in self._kinds or frames.kind == FrameKind.GLOBAL:
            return frames
        seat, uavs = self._plan.seat(frames.round), self._plan.scenario.uavs
        target = links_of(frames)[:, 1]
        arrive = (target < uavs) | (present[target] & present[seat] & (seat >= uavs))  # the wire ends at stations
        there = picked(frames, arrive)
        if there is None:
            return None
        links = links_of(there).copy()
        moves = (links[:, 1] >= uavs) & (links[:, 1] != seat)
        self._count(frames, int(np.count_nonzero(moves)))
        links[moves, 1] = seat
        return msgspec.structs.replace(there, links=links)

    def spread(self, on_air: Sequence[Frames], serving: NDArray[np.intp], awake: Mask) -> Sequence[Frames]:
        """The frames that go on the air now, global models from all stations that serve a UAV.

        Args:
            serving: (N,), the node that serves each UAV. awake: (N,), UAVs whose nodes count.
        """
        if not self._kinds:
            return on_air
        serving = serving[awake]
        return [self._spread(frames, serving) for frames in on_air]

    def _spread(self, frames: Frames, serving: NDArray[np.intp]) -> Frames:
        uavs = self._plan.scenario.uavs
        serving = serving[serving >= uavs]
        if (
            frames.kind not in self._kinds
            or frames.kind != FrameKind.GLOBAL
            or frames.source[0] < uavs
            or not len(serving)
        ):
            return frames
        nodes, rows = np.unique(serving).astype(np.int32), len(frames.source)
        self._count(frames, rows * int(np.count_nonzero(nodes != frames.source[0])))
        return Frames(frames.kind, frames.round, nodes.repeat(rows), np.tile(frames.payload, (len(nodes), 1)))

    def _count(self, frames: Frames, messages: int) -> None:
        self.messages += messages
        self.bits += messages * 8 * frames.payload.itemsize * frames.payload.shape[1]
