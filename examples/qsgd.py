"""A coding in a file: QSGD, seven levels of 4 bits, rounded at random and right on average (Alistarh et al. 2017).

meanflock run --plugin examples/qsgd.py --set federation.payload=qsgd
"""

import numpy as np

import meanflock as mf

LEVELS = 7  # of each sign; a number is 0 … 14, of which 7 is zero


class QSGD(mf.Coding):
    """A number is −7 … 7 levels of its piece's largest one, rounded up or down at random."""

    name = "qsgd"
    bits = 4

    def encode(self, models):
        scales = models.scales(models.largest / LEVELS)
        draws = [
            mf.seeds.generator(self.scenario.seed, "coding", models.round * self.scenario.uavs + int(uav))
            for uav in models.uavs
        ]
        level = models.numbers / models.spread(scales)
        chance = np.stack([draw.random(level.shape[1]) for draw in draws])
        return (np.clip(np.floor(level + chance), -LEVELS, LEVELS) + LEVELS).astype(np.uint8), scales

    def decode(self, numbers, scales):
        return (numbers.astype(np.float64) - LEVELS) * scales

    def valid(self, numbers):
        return numbers <= 2 * LEVELS
