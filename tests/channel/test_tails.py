"""Tails of the laws of the radio, against SciPy and in their limits."""

import numpy as np
import pytest
from scipy import special, stats

from meanflock.channel.tails import binomial_at_most, rice_above

RTOL = 1e-12  # over the range of the scenarios
SMALLEST = 1e-250
SHARES = np.concatenate([[0.0, 1e-12, 1e-3], np.linspace(0.01, 0.99, 99), [1.0 - 1e-9, 1.0]])


def close(found: np.ndarray, expected: np.ndarray, rtol: float = RTOL) -> None:
    some = expected > SMALLEST
    assert some.any()
    np.testing.assert_allclose(found[some], expected[some], rtol=rtol)
    assert (found[~some] <= 2 * SMALLEST).all()


@pytest.mark.parametrize(
    ("xi", "chi"), [(6.649, 1.347), (0.0, 1.347), (1e-9, 1.0), (2.0, 0.5), (30.0, 1.0), (99.0, 1.0)]
)
def test_the_amplitude_of_rice_has_the_tail_of_a_noncentral_chi_square(xi: float, chi: float) -> None:
    line = xi / chi
    amplitude = np.concatenate([[0.0, 1e-6], np.linspace(0.01, line + 33.0, 500)])
    found = rice_above((chi * amplitude) ** 2, xi, chi)
    np.testing.assert_allclose(1.0 - found, special.chndtr(amplitude**2, 2.0, line**2), atol=RTOL)
    tried = np.abs(amplitude - line) < (33.0 if line < 10.0 else 7.0)  # SciPy fails in farther tails
    squared = amplitude[tried] ** 2
    close(found[tried], stats.ncx2.sf(squared, 2, line**2) if xi else np.exp(-squared / 2))


@pytest.mark.parametrize(
    ("xi", "chi"), [(0.0, 1e-300), (0.0, 1e300), (1e300, 1e-300), (1e300, 1e300), (6.649, 1e-6), (5e-324, 1.0)]
)
def test_extreme_amplitudes_have_a_probability(xi: float, chi: float) -> None:
    found = rice_above(np.array([0.0, 1e-300, 1.0, 1e300, np.inf]), xi, chi)
    assert found[0] == 1.0
    assert found[-1] == 0.0
    assert (np.diff(found) <= 0.0).all()


@pytest.mark.parametrize("n", [1, 2, 5, 8, 9, 16, 40, 100])
def test_counts_of_slots_have_the_tails_of_a_binomial(n: int) -> None:
    for k in range(n):
        close(binomial_at_most(k, n, SHARES, 1.0 - SHARES), special.bdtr(float(k), n, SHARES))
        close(binomial_at_most(n - k - 1, n, 1.0 - SHARES, SHARES), special.bdtrc(float(k), n, SHARES))


@pytest.mark.parametrize(("n", "rtol"), [(1000, 1e-11), (16_384, 1e-9), (1_000_000, 1e-7)])
def test_tails_of_many_slots_keep_fewer_digits(n: int, rtol: float) -> None:
    for k in (0, 1, n // 4, n // 2, n - 2, n - 1):
        near = np.clip(k / n + np.array([-3.0, -1.0, 0.0, 0.5, 2.0]) / np.sqrt(n), 0.0, 1.0)
        shares = np.concatenate([SHARES, near])
        close(binomial_at_most(k, n, shares, 1.0 - shares), stats.binom.cdf(k, n, shares), rtol)
