"""Radios for tests of the federation."""

from typing import Any

import msgspec
import numpy as np

import meanflock as mf


class Coin(mf.Channel):
    """Loses a share of all messages at random; the others take one slot."""

    name = "test-coin"

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        loss: float = 0.5

    def transmit(self, distance_m: np.ndarray, bits: int, rng: np.random.Generator) -> tuple[Any, Any]:
        return np.ones(len(distance_m), dtype=np.int64), rng.random(len(distance_m)) >= self.options.loss
