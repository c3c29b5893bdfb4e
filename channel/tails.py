"""Tails of the laws of the radio: the amplitude of Rice, the power of Nakagami, and the number of good slots.

They are sums of positive terms, so small tails keep their digits. A sum starts from one term and continues by ratios of
neighbouring terms (Horner's rule); terms below 1e-17 of the sum are left out.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.swarm.state import Floats

_DEVIATIONS, _MORE = 9.0, 20  # terms beyond nine standard deviations and these are left out
_STRONGEST = 1e6  # ½ξ²/χ² beyond which the amplitude is taken as normal
_LEAST_LOG = 745.0  # exp(−745) is the smallest number
_TINY = 1e-300
_FRACTIONS = 400  # of a continued fraction, enough for shapes up to 50
_SERIES_FROM = 16
_FIRST = np.array(  # log(n! eⁿ n⁻ⁿ)
    [0.0, *(math.log(math.factorial(n)) + n - n * math.log(n) for n in range(1, _SERIES_FROM))]
)


def rice_above(squared: Floats, xi: float, chi: float) -> Floats:
    """P[z² ≥ `squared`] for z = |ξ + χ(n₁ + jn₂)|, which is Marcum's Q₁(ξ/χ, √squared/χ); `(K,)` to `(K,)`.

    It is P[Poisson(½ squared/χ²) ≤ Poisson(½ξ²/χ²)]. Where ξ > 1414 χ, z is taken as normal, with an error below 1e-6.
    """
    strength = 0.5 * (xi / chi) * (xi / chi)
    amplitude = np.sqrt(squared)
    if strength > _STRONGEST:
        with np.errstate(over="ignore"):
            away = ((amplitude - xi) / chi - 0.5 * chi / xi) * math.sqrt(0.5)
        return np.array([0.5 * math.erfc(distance) for distance in away.tolist()])
    most = (math.sqrt(strength) + math.sqrt(_LEAST_LOG)) ** 2  # of the rate; from here on the result is 0
    rate = 0.5 * (np.minimum(amplitude, 2.0 * chi * math.sqrt(most)) / chi) ** 2
    above: Floats = np.where(rate < most, np.minimum(_not_more_often(rate, strength), 1.0), 0.0)
    return above


def gamma_above(shape: float, least: Floats) -> Floats:
    """P[Gamma(shape) ≥ `least`], the regularised upper incomplete gamma function; `(K,)` to `(K,)`.

    A series below shape + 1, and Lentz's continued fraction above: Numerical Recipes §6.2.
    """
    least = np.maximum(least, _TINY)
    with np.errstate(under="ignore"):
        head = np.exp(shape * np.log(least) - least - math.lgamma(shape))
    is_low = least < shape + 1.0
    result = np.empty(least.shape)
    result[is_low] = 1.0 - head[is_low] * _gamma_series(shape, least[is_low])
    result[~is_low] = head[~is_low] * _gamma_fraction(shape, least[~is_low])
    return np.clip(result, 0.0, 1.0)


def _gamma_series(shape: float, x: Floats) -> Floats:
    """Σ_n xⁿ / (shape (shape + 1) … (shape + n))."""
    term = np.full(x.shape, 1.0 / shape)
    total = term.copy()
    n = 0
    while (term > 1e-17 * total).any():
        n += 1
        term *= x / (shape + n)
        total += term
    return total


def _gamma_fraction(shape: float, x: Floats) -> Floats:
    """1/(x + 1 − shape − 1(1 − shape)/(x + 3 − shape − …))."""
    b = x + 1.0 - shape
    c, d = np.full(x.shape, 1e300), 1.0 / b
    found = d.copy()
    for i in range(1, _FRACTIONS):
        a = -i * (i - shape)
        b += 2.0
        d = 1.0 / (a * d + b)
        c = b + a / c
        step = d * c
        found *= step
        if (np.abs(step - 1.0) < 1e-15).all():
            break
    return found


def normal_below(z: Floats) -> Floats:
    """P[standard normal ≤ z]; `(K,)` to `(K,)`."""
    return np.array([0.5 * math.erfc(-math.sqrt(0.5) * one) for one in z.tolist()])


def binomial_at_most(k: int, n: int, p: Floats, q: Floats) -> Floats:
    """P[Binomial(n, p) ≤ k] for 0 ≤ k < n; `(K,)` to `(K,)`.

    Args:
        q: 1 − p; the caller gives both, so that neither loses digits.
    """
    below = k <= n * p
    result = np.empty(p.shape)
    if below.any():
        result[below] = _lower_tail(k, n, p[below], q[below])
    if not below.all():
        result[~below] = 1.0 - _lower_tail(n - k - 1, n, q[~below], p[~below])
    return result


def _lower_tail(k: int, n: int, p: Floats, q: Floats) -> Floats:
    """P[Binomial(n, p) ≤ k] for k ≤ np: the last term is the largest."""
    p, q = np.maximum(p, _TINY), np.maximum(q, _TINY)
    odds = q / p
    total = np.ones(p.shape)
    terms = math.ceil(0.5 * _DEVIATIONS * math.sqrt(n)) + _MORE
    for j in range(max(1, k - terms), k + 1):
        total *= odds * (j / (n - j + 1))
        total += 1.0
    ways = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
    return np.minimum(np.exp(ways + k * np.log(p) + (n - k) * np.log(q)) * total, 1.0)


def _not_more_often(rate: Floats, strength: float) -> Floats:
    """P[Poisson(rate) ≤ Poisson(strength)] = Σ_k P[Poisson(rate) = k] P[Poisson(strength) ≥ k], of rates `(K,)`."""
    likely = np.minimum(rate, np.sqrt(strength * rate))  # the k of the largest term
    deviation = _DEVIATIONS * np.sqrt(likely)
    first = np.maximum(0.0, np.floor(likely - deviation))
    terms = math.ceil((likely + deviation - first).max(initial=0.0)) + _MORE
    sums = np.empty(rate.shape)
    kernels.poisson(rate, first, terms, _reached(strength), sums)
    result: Floats = np.exp(-_log_inverse(first) - _deviance(first, rate)) * sums
    return result


@lru_cache(maxsize=8)
def _reached(strength: float) -> Floats:
    """P[Poisson(strength) ≥ k] for k = 0, 1, … up to a k that is never reached; the last is 0."""
    most = strength + (math.sqrt(_LEAST_LOG) + _DEVIATIONS) * math.sqrt(strength) + _LEAST_LOG
    counts = np.arange(math.ceil(most), dtype=np.float64)
    each = np.exp(-_log_inverse(counts) - _deviance(counts, np.array([strength])))
    sums = np.append(np.cumsum(each[::-1])[::-1], 0.0)
    sums[0] = 1.0  # the sum of all, without its rounding
    return sums


def _log_inverse(n: Floats) -> Floats:
    """−log P[Poisson(n) = n] = log(n! eⁿ n⁻ⁿ) of whole numbers, by Stirling's series where they are large."""
    large = np.maximum(n, _SERIES_FROM)
    inverse = 1.0 / (large * large)
    series = (1 / 12 - inverse * (1 / 360 - inverse * (1 / 1260 - inverse / 1680))) / large
    index: NDArray[np.intp] = np.minimum(n, _SERIES_FROM - 1).astype(np.intp)
    return np.where(n < _SERIES_FROM, _FIRST[index], series + 0.5 * np.log(2.0 * math.pi * large))


def _deviance(count: Floats, mean: Floats) -> Floats:
    """count log(count / mean) + mean − count, exact also where both are close; broadcast."""
    apart = count - mean
    logs = np.log1p(np.maximum(apart / np.maximum(mean, _TINY), -1.0 + 1e-16))
    return np.where(count > 0, count * logs - apart, mean)
