"""Selection of the frames that a controller uses: those of one kind, and of these the ones that can be true."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import DTypeLike, NDArray

from meanflock.agent.controllers.base import Received
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import POSITION, VELOCITY, Floats, Mask, distinct
from meanflock.swarm.wire.messages import NOBODY


def of_kind(
    received: Sequence[Received], numbers: int, dtype: DTypeLike = np.float64, number: int = 0
) -> list[Received]:
    """Frames with `numbers` columns of `dtype` that were sent as broadcast `number` of a tick."""
    return [
        frames
        for frames in received
        if frames.number == number and frames.payload.shape[1] == numbers and frames.payload.dtype == dtype
    ]


def believed(
    received: Iterable[Received], possible: Callable[[Floats], Mask]
) -> tuple[list[Received], NDArray[np.int32]]:
    """Frames without links of payloads that are not `possible`; and who sent those, ascending, for `Step.refused`."""
    taken, refused = [], []
    for frames in received:
        good = possible(frames.payload)
        if not good.all():
            refused.append(frames.source[~good])
            links = frames.links[good[frames.links[:, 0]]]
            frames = Received(frames.number, frames.source, frames.payload, links)
        taken.append(frames)
    return taken, distinct(np.concatenate(refused)).astype(np.int32) if refused else NOBODY


def plausible(scenario: Scenario) -> Callable[[Floats], Mask]:
    """Make a function from states (S, 4) to a mask (S,) of those that a UAV can have.

    No UAV is faster than `radio.plausible_speed`, nor farther from the origin than any can have come from its start at
    that speed.
    """
    speed = scenario.radio.plausible_speed
    farthest = float(np.hypot(*starts(scenario)[:, POSITION].T).max())
    reach = farthest + speed * scenario.duration

    def can_be(states: Floats) -> Mask:
        numbers = states.astype(np.float64, copy=False)  # of whole numbers the square may not fit in as many bits
        squared = numbers * numbers
        position, velocity = squared[:, POSITION].sum(axis=-1), squared[:, VELOCITY].sum(axis=-1)
        possible: Mask = (position <= reach * reach) & (velocity <= speed * speed)
        return possible

    return can_be
