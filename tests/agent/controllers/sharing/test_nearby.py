"""Pairs of UAVs that are near, as a loop over all finds them, and what they add up to."""

import numpy as np
import pytest

from meanflock.agent.controllers.sharing.nearby import closest, near, summed

DRAW = np.random.default_rng(0)
OWN, KNOWN, UAVS = DRAW.normal(0, 3, (4, 4)), DRAW.normal(0, 3, (4, 9, 4)), DRAW.choice(9, 4, replace=False)


@pytest.mark.parametrize("range_m", [0.5, 3.0, 100.0])
def test_pairs_and_sums_are_those_of_a_loop(range_m: float) -> None:
    pairs, place, sums = near(OWN, KNOWN, UAVS, range_m), 0, np.zeros((4, 2))
    for row in range(4):
        for other in range(9):
            apart = OWN[row] - KNOWN[row, other]
            if other == UAVS[row] or np.hypot(*apart[:2]) > range_m:
                continue
            assert (pairs.row[place], pairs.other[place]) == (row, other)
            np.testing.assert_array_equal(np.concatenate([pairs.apart[place], pairs.closing[place]]), apart)
            assert pairs.distance[place] == pytest.approx(np.hypot(*apart[:2]), rel=1e-14)
            np.testing.assert_allclose(pairs.away[place] * pairs.distance[place], apart[:2], rtol=1e-13)
            sums[row] += apart[:2]
            place += 1
    assert place == len(pairs.row)
    np.testing.assert_allclose(summed(pairs.row, pairs.apart, 4), sums, atol=1e-13)


def test_the_closest_are_those_within_reach_and_no_more_than_asked_for() -> None:
    others = np.zeros((1, 6, 4))
    others[0, :, 0] = [0.0, 3.0, 1.0, -1.0, 7.0, 2.0]
    for most, expected in ((3, [-1.0, 1.0, -2.0]), (5, [-1.0, 1.0, -2.0, -3.0])):  # of equal ones the lower number
        found = closest(others[:, 0], others, np.array([0]), reach_m=5.0, most=most)
        assert found.away[0, found.present[0], 0].tolist() == expected
