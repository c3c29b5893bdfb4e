"""Laws of small-scale fading: the power gain of a link in a slot, independent in every slot, of mean 1."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.channel import tails
from meanflock.swarm.state import Floats


class Gain(NamedTuple):
    """Law of a gain: (|line + scatter (n₁ + jn₂)|² + Gamma(shape)) / mean, of standard normal n.

    All laws below use either the first or the second term.
    """

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


class Gains:
    """Some laws; links name theirs by its index."""

    def __init__(self, laws: Sequence[Gain]) -> None:
        self.laws = tuple(laws)
        self._line, self._scatter, self._shape, self._mean = np.array(self.laws).T

    def transmit(
        self, law: NDArray[np.intp], least: Floats, needed: int, most: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Sends a message over K links until `needed` slots were good, `most` slots at most.

        Draws in every slot for the links that are still busy, in link order.

        Args:
            law: (K,) index of each link's law. least: (K,) gain from which a slot is good.

        Returns:
            Slots (K,) and delivered (K,).
        """
        links = len(law)
        if needed > most:
            return np.full(links, most, dtype=np.int64), np.zeros(links, dtype=bool)
        thresholds = self._mean[law] * least
        line, scatter, shape = self._line[law], self._scatter[law], self._shape[law]
        is_gamma = bool(shape.any())
        slots = np.empty(links, dtype=np.int64)
        missing, busy, left = np.full(links, needed), np.arange(links), links
        for slot in range(1, most + 1):
            now = busy[:left]
            amplitude = rng.standard_normal((left, 2))
            amplitude *= scatter.take(now)[:, None]
            amplitude[:, 0] += line.take(now)
            if is_gamma:
                rows = shape.take(now).nonzero()[0]
                amplitude[rows, 0] = np.sqrt(rng.standard_gamma(shape[now[rows]]))
            left = kernels.fade(amplitude, 0.0, 1.0, thresholds, slot, busy, missing, slots)
            if not left:
                break
        delivered = np.ones(links, dtype=bool)
        delivered[busy[:left]] = False
        return slots, delivered
