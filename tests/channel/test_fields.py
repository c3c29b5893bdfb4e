"""Fields of places: their covariance over seeds, the covariance of links, and how long a UAV stays in sight."""

import numpy as np
import pytest

from meanflock.channel.fields import GaussianField, normal_with
from meanflock.channel.tails import normal_below

LAGS_M = np.array([0.0, 5.0, 10.0, 20.0, 37.0, 74.0])
SEEDS = 300


def along_lags(places: int, rng: np.random.Generator) -> np.ndarray:
    """Places (places × lags, 3), m: each with its neighbours at all lags in some direction, at other heights."""
    start, angle = rng.uniform(-500, 500, (places, 1, 2)), rng.uniform(0, 2 * np.pi, (places, 1))
    way = LAGS_M * np.stack([np.cos(angle), np.sin(angle)])
    flat = start + np.moveaxis(way, 0, -1)
    return np.concatenate([flat, rng.uniform(10, 300, (*flat.shape[:2], 1))], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("is_smooth", [False, True])
def test_the_covariance_over_seeds(is_smooth: bool) -> None:
    place_m = along_lags(40, np.random.default_rng(9))
    uav, station = np.arange(len(place_m)), np.full(len(place_m), len(place_m))
    place_m = np.concatenate([place_m, np.zeros((1, 3))])
    found, fourth = np.zeros(len(LAGS_M)), 0.0
    for seed in range(SEEDS):
        field = GaussianField(seed, "shadow", len(uav), 1, is_smooth).between(place_m, uav, station, True, 37.0)
        rows = field.reshape(-1, len(LAGS_M))
        found += (rows[:, :1] * rows).mean(axis=0) / SEEDS
        fourth += (rows**4).mean() / SEEDS
    ratio = LAGS_M / 37.0
    assert found == pytest.approx(np.exp(-(ratio**2) if is_smooth else -ratio), abs=0.02)
    assert fourth == pytest.approx(3.0, abs=0.15)


def test_links_of_a_uav_share_half_of_their_variance_and_stations_none() -> None:
    place_m = np.array([[0.0, 0, 40], [800, 0, 40], [-800, 300, 40], [0, 900, 10], [50, 50, 10]])
    pairs, ground = ((0, 0, 1), (1, 2, 2)), ((0, 1, 0), (3, 3, 4))  # three UAVs, two stations
    fields = [GaussianField(seed, "shadow", 3, 2) for seed in range(3000)]
    links = np.empty((len(fields), 6))
    for row, field in zip(links, fields, strict=True):
        row[:3] = field.between(place_m, *map(np.array, pairs), False, 20.0)
        row[3:] = field.between(place_m, *map(np.array, ground), True, 20.0)
    expected = np.eye(6)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        expected[one, other] = expected[other, one] = 0.5
    assert links.T @ links / len(links) == pytest.approx(expected, abs=0.07)


@pytest.mark.parametrize("is_ground", [False, True])
def test_a_link_has_its_number_whichever_links_are_asked_for(is_ground: bool) -> None:
    rng = np.random.default_rng(2)
    place_m = rng.uniform(-200, 200, (12, 3))
    low, high = np.triu_indices(12, 1)
    kind = (low < 10) & ((high >= 10) == is_ground)
    low, high = low[kind], high[kind]
    all_links = GaussianField(5, "sight", 10, 2).between(place_m, low, high, is_ground, 50.0)
    some = rng.permutation(len(low))[:9]
    again = GaussianField(5, "sight", 10, 2).between(place_m, low[some], high[some], is_ground, 50.0)
    np.testing.assert_array_equal(again, all_links[some])


def test_a_share_of_normal_numbers() -> None:
    share = np.array([0.0, 1e-5, 0.1, 0.5, 0.9999, 1.0])
    assert normal_below(normal_with(share)) == pytest.approx(share, abs=2e-6)


def test_sight_changes_a_few_times_on_the_way() -> None:
    place_m = np.zeros((381, 3))
    place_m[:, 0] = np.linspace(20, 400, 381)
    uav, station = np.arange(380), np.full(380, 380)
    changes, share = [], []
    for seed in range(200):
        sight = (
            normal_below(
                GaussianField(seed, "sight", 380, 1, is_smooth=True).between(place_m, uav, station, True, 50.0)
            )
            < 0.5
        )
        changes.append(np.count_nonzero(np.diff(sight)))
        share.append(sight.mean())
    assert np.mean(changes) == pytest.approx(379 * np.sqrt(2) / 50 / np.pi, abs=0.4)  # Rice's formula
    assert np.mean(share) == pytest.approx(0.5, abs=0.04)
