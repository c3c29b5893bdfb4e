"""Pairs of who is near, as a loop over all finds them, and sums that a row has to itself."""

import numpy as np
import pytest

from meanflock.agent.controllers.sharing.nearby import edges, near, summed


def swarm(rows: int, uavs: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    return draw.normal(0, 3, (rows, 4)), draw.normal(0, 3, (rows, uavs, 4)), draw.choice(uavs, rows, replace=False)


@pytest.mark.parametrize("range_m", [0.5, 3.0, 100.0])
def test_pairs_are_those_a_loop_finds(range_m: float) -> None:
    own, known, uavs = swarm(4, 9)
    pairs, place = near(own, known, uavs, range_m), 0
    for row in range(4):
        for other in range(9):
            apart = own[row] - known[row, other]
            if other == uavs[row] or np.hypot(*apart[:2]) > range_m:
                continue
            assert (pairs.row[place], pairs.other[place]) == (row, other)
            np.testing.assert_array_equal(np.concatenate([pairs.apart[place], pairs.closing[place]]), apart)
            assert pairs.distance[place] == pytest.approx(np.hypot(*apart[:2]), rel=1e-14)
            np.testing.assert_allclose(pairs.away[place] * pairs.distance[place], apart[:2], rtol=1e-13)
            place += 1
    assert place == len(pairs.row)


def test_of_the_pairs_in_range_only_those_that_matter() -> None:
    own, known, uavs = swarm(4, 9)
    every = near(own, known, uavs, 5.0)
    some = near(own, known, uavs, 5.0, lambda squared, difference: (squared < 4.0) | (difference > 30.0))
    kept = (every.distance < 2.0) | ((every.closing**2).sum(axis=1) > 30.0)
    assert 0 < kept.sum() < len(kept)
    assert some.other.tolist() == every.other[kept].tolist()


def test_two_in_one_place_part_to_opposite_sides() -> None:
    own = np.zeros((2, 4))
    pairs = near(own, np.zeros((2, 2, 4)), np.array([0, 1]), 1.0)
    assert pairs.away.tolist() == [[-1.0, 0.0], [1.0, 0.0]]


def test_alone_there_are_no_pairs() -> None:
    assert not len(near(np.zeros((1, 4)), np.zeros((1, 1, 4)), np.zeros(1, int), 9.0).row)
    assert near(np.zeros((0, 4)), np.zeros((0, 3, 4)), np.zeros(0, int), 9.0).apart.shape == (0, 2)
    assert summed(np.zeros(0, int), np.zeros((0, 2)), 3).tolist() == [[0.0, 0.0]] * 3


def test_a_row_sums_the_same_bits_alone() -> None:
    own, known, uavs = swarm(6, 40, seed=4)
    pairs = near(own, known, uavs, 100.0)
    together = summed(pairs.row, pairs.apart / 3.0, 6)
    np.testing.assert_allclose(together[2], (own[2, :2] - np.delete(known[2], uavs[2], axis=0)[:, :2]).sum(axis=0) / 3)
    for row in range(6):
        one = near(own[row : row + 1], known[row : row + 1], uavs[row : row + 1], 100.0)
        assert summed(one.row, one.apart / 3.0, 1).tobytes() == together[row : row + 1].tobytes()


def test_the_edge_of_a_disc_is_its_radius_off_its_centre() -> None:
    distance, x, y = edges(np.array([[3.0, 4.0, 0, 0], [0.0, 0.5, 0, 0]]), np.array([[0.0, 0.0, 1.0], [3.0, 0.0, 2.0]]))
    np.testing.assert_allclose(distance, [[4.0, 2.0], [-0.5, np.hypot(3, 0.5) - 2.0]])
    np.testing.assert_allclose(np.hypot(x, y), 1.0)
    assert (x[0, 0], y[0, 0], x[0, 1], y[0, 1]) == pytest.approx((0.6, 0.8, 0.0, 1.0))
