"""A line of UAVs, and frames for the medium between them."""

from typing import Any

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames

UAVS = 6


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, [f"uavs={UAVS}", *settings], **options)


def line(*metres: float) -> state.States:
    """UAVs at rest along x."""
    states = np.zeros((len(metres), state.SIZE))
    states[:, state.X] = metres
    return states


def frames(kind: FrameKind, source: list[int], floats: int, number: int = 0) -> Frames:
    payload = np.arange(len(source) * floats, dtype=np.float32).reshape(len(source), floats)
    return Frames(kind, number, np.array(source, dtype=np.int32), payload)


def links_of(batches: list[Frames]) -> set[tuple[int, int]]:
    """[source, target] of what was delivered, each once."""
    found = [
        (int(batch.source[row]), int(target))
        for batch in batches
        if batch.links is not None
        for row, target in batch.links
    ]
    assert len(found) == len(set(found))
    return set(found)
