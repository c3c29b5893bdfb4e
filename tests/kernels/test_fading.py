"""A slot of Rice fading: both forms against a loop over the links."""

from types import ModuleType

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@both_forms
@given(st.integers(1, 40), st.integers(1, 3), st.booleans(), st.integers(0, 2**32 - 1))
def test_a_message_is_sent_link_by_link(backend: ModuleType, links: int, needed: int, alike: bool, seed: int) -> None:
    draw = np.random.default_rng(seed)
    xi, chi = draw.uniform(0, 3), draw.uniform(0.1, 2)
    thresholds = draw.uniform(0, 6, 1 if alike else links)
    busy, missing, slots = np.arange(links), np.full(links, needed), np.full(links, -1)
    expected_busy, expected_missing, expected_slots = list(range(links)), [needed] * links, [-1] * links
    for slot in range(1, 6):
        normal = draw.standard_normal((len(expected_busy), 2))
        for link, (along, across) in zip(expected_busy.copy(), normal.tolist(), strict=True):
            x, y = along * chi + xi, across * chi
            expected_missing[link] -= x * x + y * y >= thresholds[0 if alike else link]
            expected_slots[link] = slot
            if not expected_missing[link]:
                expected_busy.remove(link)
        left = backend.fade(normal, xi, chi, thresholds, slot, busy, missing, slots)
        assert busy[:left].tolist() == expected_busy
        assert missing.tolist() == expected_missing
        assert slots.tolist() == expected_slots


def test_a_bound_that_is_no_number_is_never_reached(backend: ModuleType) -> None:
    busy, missing, slots = np.arange(2), np.ones(2, np.int64), np.full(2, 9)
    assert backend.fade(np.ones((2, 2)), 1.0, 1.0, np.array([np.nan, 0.0]), 3, busy, missing, slots) == 1
    assert busy[0] == 0
    assert slots.tolist() == [3, 3]


@both_forms
@given(st.integers(0, 6), st.integers(0, 30), st.booleans(), st.integers(0, 2**32 - 1))
def test_terms_of_poisson_are_summed_from_the_last(
    backend: ModuleType, rates: int, terms: int, late: bool, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    rate, reached = draw.uniform(0, 20, rates), draw.uniform(0, 1, 12)
    first = draw.integers(0, 20, rates).astype(float) * late
    sums = np.full(rates, np.nan)
    backend.poisson(rate, first, terms, reached, sums)
    for row in range(rates):
        expected = 0.0
        for k in range(terms, -1, -1):
            expected *= rate[row] / (first[row] + (k + 1.0))
            expected += reached[min(int(first[row]) + k, 11)]
        assert sums[row] == expected
