"""Laws of small-scale fading: the power gain of a link in a slot, independent in every slot, of mean 1."""

import math
from typing import NamedTuple

import numpy as np

from meanflock.channel import tails
from meanflock.swarm.state import Floats


class Gain(NamedTuple):
    """Law of a gain: |line + scatter (n₁ + jn₂)|² / mean, of standard normal n, or Gamma(shape) / mean."""

    line: float = 0.0
    scatter: float = 0.0
    shape: float = 0.0
    mean: float = 1.0

    @property
    def is_steady(self) -> bool:
        """Returns whether the gain is always 1."""
        return not self.scatter and not self.shape

    def success(self, least: Floats) -> Floats:
        """P[gain ≥ `least`], (K,) to (K,)."""
        if self.is_steady:
            return (least <= 1.0).astype(np.float64)
        if self.shape:
            return tails.gamma_above(self.shape, self.mean * least)
        return tails.rice_above(self.mean * least, self.line, self.scatter)


STEADY = Gain(line=1.0)
RAYLEIGH = Gain(scatter=1.0, mean=2.0)


def rice(k_db: float) -> Gain:
    """A line of sight K times as strong as all scattered paths together."""
    k = 10.0 ** (k_db / 10.0)
    return Gain(line=math.sqrt(2.0 * k), scatter=1.0, mean=2.0 * (1.0 + k))


def rice_by_elevation(horizon_db: float, zenith_db: float) -> list[Gain]:
    """Laws of Rice by elevation, 0 to 90 whole degrees: K grows exponentially from the horizon to the zenith.

    Azari, Rosas, Chen, Pollin, Ultra reliable UAV communication, IEEE Transactions on Communications 66(1), 2018.
    """
    return [rice(horizon_db + (zenith_db - horizon_db) * degrees / 90.0) for degrees in range(91)]


def nakagami(m: float) -> Gain:
    """Nakagami's amplitude: the power is Gamma(m)/m. m = 1 is Rayleigh."""
    return Gain(shape=m, mean=m)
