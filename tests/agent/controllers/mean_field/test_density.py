"""The density every UAV starts from."""

import tracemalloc
from itertools import product

import numpy as np
import pytest

from meanflock.agent.controllers.mean_field import learner as learner_module
from meanflock.agent.controllers.mean_field.learner import Learner
from meanflock.kernels.mean_field import layout
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.seeds import generator

EXPONENTS = np.array([row for row in product(range(5), repeat=4) if 1 <= sum(row) <= 4])
SCALE = np.array([200.0, 200.0, 20.0, 20.0])
BANDWIDTH = np.array([3.0, 3.0, 0.7, 0.7])


def scenario(*settings: str, method: str = "mfgfl-hf") -> Scenario:
    return load(None, list(settings), method=method)


def fitted(flown: Scenario, rows: int = 1) -> np.ndarray:
    return Learner(flown, learns_density=flown.method != "hjb").init(rows, starts(flown))


def density(weights: np.ndarray) -> np.ndarray:
    """[ŵ_F0, ŵ_F1], `(M, 2, 69)`."""
    return weights[:, layout.DENSITY].reshape(-1, 2, layout.DENSITY_FEATURES)


def value_at(weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    return (weights * np.prod((points / SCALE)[:, None, :] ** EXPONENTS, axis=-1)).sum(axis=-1)


def mixture(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The Gaussian mixture, its largest value at a centre being one."""

    def raw(at: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * (((at[:, None] - centres) / BANDWIDTH) ** 2).sum(axis=-1)).sum(axis=-1)

    return raw(points) / raw(centres).max()


def test_the_fit_has_the_mixture_s_mass_near_the_swarm_and_next_to_none_elsewhere() -> None:
    """Degree four over a box of 400 m cannot resolve a swarm of 8 m; it can say where it is."""
    flown, draw = scenario(), np.random.default_rng(1)
    centres = starts(flown)
    weights = density(fitted(flown))[0, 0]
    near = centres[draw.integers(25, size=2000)] + 2 * BANDWIDTH * draw.standard_normal((2000, 4))
    expected, found = mixture(near, centres), value_at(weights, near)
    assert found.mean() == pytest.approx(expected.mean(), rel=0.2)
    assert ((found - expected) ** 2).mean() < (expected**2).mean()  # better than no density at all
    assert np.corrcoef(expected, found)[0, 1] > 0.1
    elsewhere = value_at(weights, draw.uniform(-SCALE, SCALE, (2000, 4)))
    assert value_at(weights, centres).min() > 3 * np.sqrt((elsewhere**2).mean())
    along = value_at(weights, np.linspace(0, 1, 5)[:, None] * np.array([150.0, 100.0, 0.0, 0.0]))
    assert (np.diff(along) > 0).all()  # from the destination to the start


def test_no_other_weights_fit_the_samples_better() -> None:
    """The gradient of the least-squares objective vanishes; checked on the sample points every UAV draws."""
    flown = scenario("density.near_samples=300", "density.box_samples=300")
    weights = density(fitted(flown))[0, 0]
    draw, centres = generator(flown.seed, "density-fit"), starts(flown)
    chosen = draw.integers(len(centres), size=300)
    points = np.concatenate(
        [
            centres[chosen] + 2 * BANDWIDTH * draw.standard_normal((300, 4)),
            SCALE * draw.uniform(-1, 1, (300, 4)),
        ]
    )
    features = np.prod((points / SCALE)[:, None, :] ** EXPONENTS, axis=-1)
    error = features @ weights - mixture(points, centres)
    gradient = features.T @ error / len(points) + flown.density.ridge * weights
    assert np.abs(gradient).max() < 1e-9


def test_every_uav_computes_the_same_bits_twice() -> None:
    one, other = fitted(scenario(), rows=3), fitted(scenario(), rows=1)
    assert density(one)[0].tobytes() == density(other)[0].tobytes()
    for row in density(one):
        assert row.tobytes() == density(one)[0].tobytes()
    assert density(fitted(scenario("seed=2")))[0].tobytes() != density(one)[0].tobytes()


def test_what_is_not_fitted_starts_at_zero() -> None:
    weights = fitted(scenario(), rows=2)
    assert not weights[:, layout.VALUE].any()
    assert density(weights)[:, 0].any()
    assert not density(weights)[:, 1].any()
    assert not fitted(scenario(method="hjb"), rows=2).any()


@pytest.mark.parametrize("uavs", [1, 2, 7])
def test_a_swarm_of_any_size_has_a_density(uavs: int) -> None:
    weights = density(fitted(scenario(f"uavs={uavs}")))
    assert np.isfinite(weights).all()
    assert weights[:, 0].any()


def test_a_zero_start_never_learns_a_density() -> None:
    """Why the fit is there at all: F̂ is homogeneous in ŵ_F."""
    flown = scenario()
    weights, learner = fitted(scenario(method="hjb"), rows=4), Learner(flown)
    draw = np.random.default_rng(3)
    for _ in range(20):
        weights, numbers = learner.step(weights, draw.uniform(-1, 1, (4, 4)) * SCALE / 2, None)
        np.testing.assert_array_equal(numbers[:, 3], 0.0)
    assert not density(weights).any()
    assert weights[:, layout.VALUE].any()


def test_a_fit_to_many_needs_no_room_for_all_pairs_of_them_and_gives_the_same_bits() -> None:
    draw = np.random.default_rng(4)
    centres = draw.standard_normal((1500, 4)) * [30.0, 30.0, 1.0, 1.0]
    tracemalloc.start()
    try:
        found = learner_module.mixture(centres, centres, BANDWIDTH)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 32 * 2**20 < 4 * 8 * 1500**2
    some = slice(None, None, 37)  # other points share a block
    np.testing.assert_array_equal(found[some], learner_module.mixture(centres[some], centres, BANDWIDTH))
