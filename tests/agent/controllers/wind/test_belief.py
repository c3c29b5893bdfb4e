"""The map of the wind: interpolation, additive information, and the mean of a Gaussian field."""

import numpy as np
import pytest

from meanflock.agent.controllers.wind.belief import WindGrid

BACK = np.array([0.8, 0.6])


def grid(spacing: float = 10.0) -> WindGrid:
    return WindGrid(np.array([5.0, -3.0]), BACK, 60.0, 20.0, spacing, 1.0, 15.0)


def test_a_linear_wind_is_interpolated_exactly_and_is_constant_beyond_the_edge() -> None:
    map_ = grid()
    maps = (map_.nodes @ np.array([[0.1, -0.2], [0.3, 0.05]]))[None]
    inside = map_.nodes.mean(axis=0) + np.random.default_rng(0).uniform(-12, 12, (1, 30, 2))
    assert map_.at(maps, inside) == pytest.approx(inside @ np.array([[0.1, -0.2], [0.3, 0.05]]))
    corner = map_.nodes[0]
    assert map_.at(maps, (corner - 1e3 * BACK - 1e3 * np.array([-0.6, 0.8]))[None]) == pytest.approx(maps[:, 0])
    _, share = map_.shares(inside)
    assert share.sum(axis=-1) == pytest.approx(1.0)
    assert (share >= 0).all()


def test_the_mean_is_that_of_a_gaussian_field_measured_at_its_nodes() -> None:
    map_, draw = grid(), np.random.default_rng(2)
    which = np.array([2, 11, 30])
    wind, precision = draw.standard_normal((3, 2)), np.array([4.0, 1.0, 9.0])
    information = map_.informed(np.zeros(3, dtype=int), map_.nodes[which], wind, precision, 1)
    apart = ((map_.nodes[:, None] - map_.nodes[None]) ** 2).sum(axis=-1)
    kernel = (1.0 + apart / (4.0 * 15.0**2)) ** -2
    weights = np.linalg.solve(kernel[np.ix_(which, which)] + np.diag(1.0 / precision), wind)
    assert map_.mean(information)[0] == pytest.approx(kernel[:, which] @ weights, abs=1e-9)
