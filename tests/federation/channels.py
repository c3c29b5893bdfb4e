"""Radios for tests of the federation."""

import numpy as np

import meanflock as mf


class Coin(mf.Channel):
    """Loses every other message at random; the others take one slot."""

    name = "test-coin"

    def transmit(self, distance_m: np.ndarray, bits: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return np.ones(len(distance_m), dtype=np.int64), rng.random(len(distance_m)) < 0.5
