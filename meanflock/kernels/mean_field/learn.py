"""A step of the mean-field learners, in NumPy; its compiled form is in `learn.c` and `rows.h`."""

from typing import Any

import numpy as np

from meanflock.kernels.mean_field import features, fpk, hjb, interaction
from meanflock.kernels.mean_field.layout import Tables, layout_of
from meanflock.kernels.state import Floats


def prepare(given: Tables) -> Any:
    """The tables in the form that `learn` takes, which other code must not read."""
    return given


def learn(
    tables: Tables, states: Floats, weights: Floats, around: Floats | None, weights_out: Floats, numbers: Floats
) -> None:
    """One tick of the mean-field learners of M UAVs: φ_G, the value step, the density step, the action.

    Args:
        states: (M, 2d). weights: (M, 246), in space (M, 580), [ŵ_H0, ŵ_H1, ŵ_F0, ŵ_F1].
        around: None: the density is learned and φ_G is its quadrature. Else the density stays as it is, and φ_G is
            the mean over the states known to each row, (M, N, 2d), with β = 1; or it is given, (M,).
        weights_out: as `weights`, written; may be `weights`. numbers: (M, d + 3), written: [a, e_H, e_F, φ_G].
    """
    _, _, features_of_density, _, of_value, of_density, _, _ = layout_of(len(tables.wind))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        powers = features.powers(tables, states)
        if around is not None:
            phi_g = around if around.ndim == 1 else interaction.empirical(states, around, tables.epsilon)
            value = hjb.step(tables, weights[:, of_value], states, powers, phi_g)
            density, residual = weights[:, of_density], np.zeros(len(states))
        else:
            pairs = features.pairs(tables, powers)
            terms = features.terms(tables, pairs)
            density = weights[:, of_density]
            phi_g = interaction.quadrature(tables, density[:, :features_of_density], terms)
            value = hjb.step(tables, weights[:, of_value], states, powers, phi_g)
            drift = hjb.drift(tables, states, value.action)
            density, residual = fpk.step(tables, density, states, pairs, terms[:, 1:], drift, value.curvature)
    weights_out[:, of_value], weights_out[:, of_density] = value.weights, density
    numbers[:, :-3] = value.action
    numbers[:, -3] = value.residual
    numbers[:, -2] = residual
    numbers[:, -1] = phi_g
