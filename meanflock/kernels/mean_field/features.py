"""Features σ_H and σ_F of the two networks, with exact derivatives: monomials of the scaled state.

Their coefficients are in the tables: 1, or those of the polynomial (`learner.multinomial`).

Every function is row-wise: row i of the result depends on row i of the arguments only, to the last bit.
"""

import numpy as np

from meanflock.kernels.mean_field.layout import PER_AXIS, Floats, Tables, layout_of

POWERS = 7  # 1, u, u² … u⁶ of each coordinate


def powers(t: Tables, states: Floats) -> Floats:
    """Powers 1, u, u² … u⁶ of each scaled coordinate u of states `(..., 4)`: `(..., 28)`."""
    result = np.empty((*states.shape, POWERS))
    result[..., 0] = 1.0
    result[..., 1:] = (states / t.scale)[..., None]
    return np.multiply.accumulate(result, axis=-1, out=result).reshape(*states.shape[:-1], states.shape[-1] * POWERS)


def value(t: Tables, given: Floats) -> Floats:
    """Features of axis x and of axis y from powers, [σ, ∂σ/∂r, ∂σ/∂v, ∂²σ/∂v²]: `(..., 4, 2, 27)`."""
    products = given.take(t.value_first, axis=-1)
    products *= given.take(t.value_second, axis=-1)
    products *= t.value_factor
    return products.reshape(*given.shape[:-1], 4, given.shape[-1] // (2 * POWERS), PER_AXIS)


def pairs(t: Tables, given: Floats) -> Floats:
    """Pairs from powers, `(..., 8, 15)`: A, ∂A/∂x, ∂A/∂y of positions; V, ∂V/∂vx, ∂V/∂vy, ∂²V/∂vx², ∂²V/∂vy² of
    velocities. In space `(..., 11, 35)`.
    """
    each = layout_of(len(t.wind)).pairs
    return _products(t, given, slice(None)).reshape(*given.shape[:-1], len(t.pair_first) // each, each)


def terms(t: Tables, given: Floats) -> Floats:
    """Terms [1, σ_F] from pairs, `(..., 70)`: x̄^a ȳ^b v̄x^c v̄y^d is a product of a position pair and a velocity pair."""
    return _joined(t, given[..., 0, :], given[..., 1 + len(t.wind), :])


def density(t: Tables, states: Floats) -> Floats:
    """Terms [1, σ_F] of states `(..., 4)`, `(..., 70)`, without the pairs that only their derivatives need."""
    each, given = layout_of(len(t.wind)).pairs, powers(t, states)
    place, pace = (_products(t, given, slice(row * each, (row + 1) * each)) for row in (0, 1 + len(t.wind)))
    return _joined(t, place, pace)


def _products(t: Tables, given: Floats, pairs: slice) -> Floats:
    """Some of the pairs from powers, side by side."""
    products = given.take(t.pair_first[pairs], axis=-1)
    for other in (t.pair_second, t.pair_third):
        if len(other):
            products *= given.take(other[pairs], axis=-1)
    products *= t.pair_factor[pairs]
    return products


def _joined(t: Tables, positions: Floats, velocities: Floats) -> Floats:
    result = positions.take(t.at_position, axis=-1) * velocities.take(t.at_velocity, axis=-1)
    result *= t.coefficient
    return result
