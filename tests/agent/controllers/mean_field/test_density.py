"""The density every UAV starts from."""

from itertools import product

import numpy as np
import pytest

from meanflock.agent.controllers.mean_field.learner import Learner
from meanflock.kernels.mean_field import layout
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import load
from meanflock.swarm.seeds import generator

EXPONENTS = np.array([row for row in product(range(5), repeat=4) if 1 <= sum(row) <= 4])
SCALE = np.array([200.0, 200.0, 20.0, 20.0])
BANDWIDTH = np.array([3.0, 3.0, 0.7, 0.7])


def mixture(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The Gaussian mixture; its largest value at a centre is one."""

    def raw(at: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * (((at[:, None] - centres) / BANDWIDTH) ** 2).sum(axis=-1)).sum(axis=-1)

    return raw(points) / raw(centres).max()


@pytest.mark.parametrize("uavs", [1, 2, 7, 25])
def test_no_other_weights_fit_the_samples_better(uavs: int) -> None:
    """The gradient of the least-squares objective vanishes; checked on the sample points every UAV draws."""
    flown = load(None, [f"uavs={uavs}", "density.near_samples=300", "density.box_samples=300"], method="mfgfl-hf")
    weights = Learner(flown).init(3, starts(flown))
    fitted = weights[0, layout.DENSITY][: layout.DENSITY_FEATURES]
    draw, centres = generator(flown.seed, "density-fit"), starts(flown)
    chosen = draw.integers(len(centres), size=300)
    near = centres[chosen] + 2 * BANDWIDTH * draw.standard_normal((300, 4))
    points = np.concatenate([near, SCALE * draw.uniform(-1, 1, (300, 4))])
    features = np.prod((points / SCALE)[:, None, :] ** EXPONENTS, axis=-1)
    error = features @ fitted - mixture(points, centres)
    gradient = features.T @ error / len(points) + flown.density.ridge * fitted
    assert fitted.any()
    assert np.abs(gradient).max() < 1e-9
    assert (weights == weights[0]).all()  # every UAV fits the same
    rest = np.delete(weights[0], np.arange(246)[layout.DENSITY][: layout.DENSITY_FEATURES])
    assert not rest.any()
