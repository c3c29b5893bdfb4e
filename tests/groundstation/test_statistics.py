"""Intervals against their definitions."""

import math

import numpy as np
import pytest
from scipy import stats

from meanflock.groundstation import statistics


def test_mean_is_students_interval() -> None:
    values = np.random.default_rng(1).normal(3.0, 2.0, 9)
    low, high = stats.t.interval(0.95, 8, values.mean(), stats.sem(values))
    estimate = statistics.mean(values)
    assert [estimate.low, estimate.high] == pytest.approx([low, high])


def test_fiellers_ends_are_where_the_t_test_turns() -> None:
    draw = np.random.default_rng(2)
    b = draw.normal(5.0, 1.0, 12)
    a = 0.7 * b + draw.normal(0.0, 0.5, 12)
    estimate = statistics.ratio(a, b)
    for end in (estimate.low, estimate.high):
        assert stats.ttest_1samp(a - end * b, 0.0).pvalue == pytest.approx(0.05)
    assert estimate.low < a.mean() / b.mean() < estimate.high
    assert not statistics.ratio([1.0, 2.0, 3.0], [-1.0, 1.0, 0.5]).bounded  # the divisor may be 0


@pytest.mark.parametrize(("hits", "n"), [(0, 10), (3, 10), (10, 10)])
def test_share_is_the_exact_interval(hits: int, n: int) -> None:
    exact = stats.binomtest(hits, n).proportion_ci(0.95, "exact")
    estimate = statistics.share([k < hits for k in range(n)])
    assert [estimate.low, estimate.high] == pytest.approx([exact.low, exact.high])


def test_rate_covers_as_it_says() -> None:
    draw = np.random.default_rng(5)
    seen = [statistics.rate(draw.poisson(0.8, 10)) for _ in range(400)]
    assert np.mean([estimate.low <= 0.8 <= estimate.high for estimate in seen]) >= 0.95
    assert statistics.rate([0] * 20).high == pytest.approx(-math.log(0.025) / 20)


def test_missing_values_leave_their_pair() -> None:
    estimate = statistics.difference([1.0, math.nan, 3.0, 4.0], [0.0, 1.0, math.nan, 2.0])
    assert (estimate.value, estimate.n) == (1.5, 2)
