"""A channel with a memory: pairs of UAVs that lose everything for a while."""

from typing import Any

import numpy as np

from meanflock.channel.base import Channel, Memory, Message


class Bursts(Channel):
    """A pair is good or bad and mostly stays so from message to message; a bad one loses all (Gilbert and Elliott)."""

    name = "bursts"

    def init(self, uavs: int) -> Memory:
        return {"bad": np.zeros((uavs, uavs), dtype=bool)}

    def carry(self, memory: Memory, message: Message, rng: np.random.Generator) -> Any:
        bad = memory["bad"].copy()
        low, high = np.minimum(message.source, message.target), np.maximum(message.source, message.target)
        pair, link = np.unique(low * len(bad) + high, return_inverse=True)
        was, draw = bad.ravel()[pair], rng.random(len(pair))
        bad.ravel()[pair] = now = np.where(was, draw < 0.8, draw < 0.05)
        return {"bad": bad}, np.ones(len(link), dtype=np.int64), ~now[link]
