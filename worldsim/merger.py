"""Merger: joins the frames that all nodes send in a tick into batches, and drops those that may not be sent."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.meter import Meter
from meanflock.federation.post import Post
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.swarm.wire.tick import bytes_of_batch


class FrameMerger:
    """Joins batches of one kind, broadcast number and form; sources ascend."""

    def __init__(self, post: Post, drop: Callable[[MessageRejected, str], None]) -> None:
        self._post, self._drop = post, drop

    def merged(self, tick: int, sent: Iterable[Frames], awake: NDArray[np.bool_], meter: Meter) -> list[Frames]:
        """The frames of a tick from those `sent`, in order of their UAVs, by UAVs that are `awake` (N,); `meter` counts
        their bytes."""
        alike: dict[tuple[int, int, str, int], list[Frames]] = {}
        for batch in sent:
            broadcast = batch.round if batch.kind == FrameKind.STATE else 0
            form = batch.kind, broadcast, batch.payload.dtype.str, batch.payload.shape[1]
            alike.setdefault(form, []).append(batch)
        # A sorted order: the division of UAVs into processes decides which batch comes first, and nothing else.
        ordered = [alike[form] for form in sorted(alike)] if len(alike) > 1 else alike.values()
        return [frames for batches in ordered if (frames := self._joined(tick, batches, awake, meter))]

    def _joined(self, tick: int, batches: list[Frames], awake: NDArray[np.bool_], meter: Meter) -> Frames | None:
        """All batches of a form as one, without frames that may not be sent."""
        together = _join(batches)
        if together is None or not self._is_sound(tick, together, awake):
            sound: list[Frames] = []
            for batch in batches:
                if (part := self._sound_part(tick, batch, awake, sound)) is not None:
                    sound.append(part)
            batches, together = sound, _join(sound)
        for batch in batches:
            meter.wire(batch.kind, bytes_of_batch(batch))
        return together

    def _is_sound(self, tick: int, batch: Frames, awake: NDArray[np.bool_]) -> bool:
        """Whether every frame of a joined batch may be sent."""
        if batch.kind != FrameKind.STATE and (
            self._post.stray(batch, tick) is not None or not (batch.source[1:] > batch.source[:-1]).all()
        ):
            return False
        return b"\0" not in awake.tobytes() or bool(awake[batch.source].all())  # as a rule all are awake

    def _sound_part(self, tick: int, batch: Frames, awake: NDArray[np.bool_], before: list[Frames]) -> Frames | None:
        """The frames of one node that may be sent, after those of nodes `before`."""
        if batch.kind != FrameKind.STATE:
            stray = self._post.stray(batch, tick)
            if stray is None and any(np.isin(batch.source, other.source).any() for other in before):
                stray = MessageRejected("duplicate", f"two {batch.kind.name} frames of one UAV")
            if stray is not None:
                self._drop(stray, f"frames of UAV {batch.source[0]}")
                return None
        speaks = awake[batch.source]
        if speaks.all():
            return batch
        return Frames(batch.kind, batch.round, batch.source[speaks], batch.payload[speaks]) if speaks.any() else None


def _join(batches: list[Frames]) -> Frames | None:
    """Batches of one kind as one; None where there are none, or of several rounds."""
    if len(batches) == 1:
        return batches[0]
    if len({batch.round for batch in batches}) != 1:
        return None
    source = np.concatenate([batch.source for batch in batches])
    return Frames(batches[0].kind, batches[0].round, source, np.concatenate([batch.payload for batch in batches]))
