"""Intervals over seeds. Every function takes plain arrays and returns an `Estimate` with its 95 % interval.

Means, differences and slopes use Student's t over seeds; a ratio of means uses Fieller's interval, which is the same t
test solved for the ratio; shares of runs use Clopper and Pearson's exact interval, event counts Garwood's. Seeds are
paired wherever two methods flew the same ones. All are deterministic: no resampling, no seed of their own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special  # scipy.stats would take most commands another 0.8 s to load

Floats = NDArray[np.float64]

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number and the ends of its 95 % interval; an end is infinite where the data do not bound it.

    n: number of seeds or runs.
    """

    value: float
    low: float
    high: float
    n: int

    @property
    def bounded(self) -> bool:
        """Returns whether both ends are finite."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def shown(self, form: str) -> str:
        """`12.3 ± 0.4`: the number and the distance to the upper end in the format `form`; unbounded: the number."""
        return f"{self.value:{form}}" + (f" ± {self.high - self.value:{form}}" if self.bounded else "")


def exact(value: float) -> Estimate:
    """An estimate without randomness, from a known number."""
    return Estimate(value, value, value, 1)


def _unbounded(value: float, n: int) -> Estimate:
    return Estimate(value, -math.inf, math.inf, n)


def _t(n: int, confidence: float) -> float:
    """Two-sided quantile of Student's t for n values."""
    return float(special.stdtrit(n - 1, 0.5 + confidence / 2))


def _known(*columns: ArrayLike) -> list[Floats]:
    """The columns as floats, without rows that have a NaN. Infinite values stay."""
    arrays = [np.asarray(column, dtype=np.float64) for column in columns]
    keep = ~np.logical_or.reduce([np.isnan(array) for array in arrays])
    return [array[keep] for array in arrays]


def mean(values: ArrayLike) -> Estimate:
    """Mean of a value a seed, with the t interval; one seed alone, or an infinite value, has no interval."""
    (finite,) = _known(values)
    n = len(finite)
    if n == 0:
        return _unbounded(math.nan, 0)
    if not np.isfinite(finite).all():
        return _unbounded(math.inf, n)
    centre = float(finite.mean())
    if n == 1:
        return _unbounded(centre, 1)
    half = _t(n, CONFIDENCE) * float(finite.std(ddof=1)) / math.sqrt(n)
    return Estimate(centre, centre - half, centre + half, n)


def difference(first: ArrayLike, second: ArrayLike) -> Estimate:
    """Mean over seeds of first − second, paired."""
    a, b = _known(first, second)
    return mean(a - b)


def ratio(first: ArrayLike, second: ArrayLike, *, confidence: float = CONFIDENCE) -> Estimate:
    """Mean(first) / mean(second), paired by seed, with Fieller's interval.

    The interval holds every θ for which a t test cannot tell the mean of first − θ·second from zero. It is unbounded
    where the denominator cannot be told from zero.
    """
    a, b = _known(first, second)
    n = len(a)
    if n == 0 or b.mean() == 0.0 or not np.isfinite([a, b]).all():
        return _unbounded(math.nan, n)
    theta = float(a.mean() / b.mean())
    if n == 1:
        return _unbounded(theta, 1)
    covariance = np.cov(a, b) / n
    t2 = _t(n, confidence) ** 2
    # (ā − θ b̄)² = t² (s_aa − 2θ s_ab + θ² s_bb), a quadratic in θ
    square = float(b.mean() ** 2 - t2 * covariance[1, 1])
    linear = float(a.mean() * b.mean() - t2 * covariance[0, 1])
    constant = float(a.mean() ** 2 - t2 * covariance[0, 0])
    if square <= 0.0:
        return _unbounded(theta, n)
    root = math.sqrt(max(0.0, linear * linear - square * constant))
    low, high = (linear - root) / square, (linear + root) / square
    return Estimate(theta, min(low, theta), max(high, theta), n)


def slopes(x: ArrayLike, rows: ArrayLike) -> Floats:
    """Least-squares slopes of the seeds' rows, `(seeds, K)`, against x, `(K,)`; NaN for a seed with a missing point."""
    grid = np.asarray(x, dtype=np.float64)
    table = np.atleast_2d(np.asarray(rows, dtype=np.float64))
    centred = grid - grid.mean()
    return (table * centred).sum(axis=-1) / (centred * centred).sum()


def share(hits: Sequence[bool] | NDArray[np.bool_]) -> Estimate:
    """Share of runs in which something happened, with the exact binomial interval of Clopper and Pearson."""
    n, k = len(hits), int(np.count_nonzero(hits))
    if n == 0:
        return Estimate(math.nan, 0.0, 1.0, 0)
    tail = (1 - CONFIDENCE) / 2
    low = float(special.betaincinv(k, n - k + 1, tail)) if k else 0.0
    high = float(special.betaincinv(k + 1, n - k, 1 - tail)) if k < n else 1.0
    return Estimate(k / n, low, high, n)


def share_at_least(hits: int, n: int) -> float:
    """One-sided 95 % lower bound, after Clopper and Pearson, of a share: `hits` of `n` runs had it."""
    return float(special.betaincinv(hits, n - hits + 1, 1 - CONFIDENCE)) if hits else 0.0


def rate(counts: ArrayLike) -> Estimate:
    """Events a run, with Garwood's exact Poisson interval of the total."""
    (finite,) = _known(counts)
    n, total = len(finite), float(finite.sum())
    if n == 0:
        return Estimate(math.nan, 0.0, math.inf, 0)
    tail = (1 - CONFIDENCE) / 2
    low = float(special.gammaincinv(total, tail)) if total else 0.0
    high = float(special.gammaincinv(total + 1, 1 - tail))
    return Estimate(total / n, low / n, high / n, n)
