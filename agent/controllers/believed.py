"""What a controller takes in of the frames that arrived: those of its kind, and of these what can be true."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import DTypeLike, NDArray

from meanflock.agent.controllers.base import Received
from meanflock.swarm.ascending import distinct
from meanflock.swarm.state import Floats, Mask
from meanflock.swarm.wire.messages import NOBODY


def of_kind(
    received: Sequence[Received], numbers: int, dtype: DTypeLike = np.float64, number: int = 0
) -> list[Received]:
    """The frames of so many numbers that were sent as the broadcast `number` of a tick."""
    return [
        frames
        for frames in received
        if frames.number == number and frames.payload.shape[1] == numbers and frames.payload.dtype == dtype
    ]


def believed(received: Iterable[Received], sane: Callable[[Floats], Mask]) -> tuple[list[Received], NDArray[np.int32]]:
    """The frames without links of a payload that is not `sane`, and who sent such, ascending, for `Step.refused`."""
    taken, refused = [], []
    for frames in received:
        good = sane(frames.payload)
        if not good.all():
            refused.append(frames.source[~good])
            links = frames.links[good[frames.links[:, 0]]]
            frames = Received(frames.number, frames.source, frames.payload, links)
        taken.append(frames)
    return taken, distinct(np.concatenate(refused)).astype(np.int32) if refused else NOBODY
