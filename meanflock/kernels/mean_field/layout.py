"""Layout of the model of a mean-field learner, and the constants of its step; `learn.h` has the same in C.

A model is one row of floats, [ŵ_H0 (54), ŵ_H1 (54), ŵ_F0 (69), ŵ_F1 (69)]; in space [81, 81, 209, 209]. A *power* is
one of 1, u, u² … u⁶ of a scaled coordinate u; four coordinates make 28. A *feature* is a product of two powers and a
factor, and a *pair* is one of a power of each axis.
"""

from functools import cache
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Floats

Indices = NDArray[np.intp]

VALUE_DEGREE, DENSITY_DEGREE = 6, 4  # of the polynomials
PER_AXIS = 27  # terms of σ_H of each axis: degree 1…6 in position and velocity


class ModelLayout(NamedTuple):
    """Sizes of a model, and places of its parts.

    axes: of a state. value_features: M_H, terms of σ_H. density_features: M_F, terms of σ_F. pairs: products of a power
    of each axis, of degree 0…4. value, density: weights of the networks in a model. floats: of a model. numbers:
    results of a step, [a, e_H, e_F, φ_G].
    """

    axes: int
    value_features: int
    density_features: int
    pairs: int
    value: slice
    density: slice
    floats: int
    numbers: int


@cache
def layout_of(axes: int) -> ModelLayout:
    """The layout for states of so many axes."""
    value, density = PER_AXIS * axes, comb(2 * axes + DENSITY_DEGREE, DENSITY_DEGREE) - 1
    floats = 2 * (value + density)
    return ModelLayout(
        axes,
        value,
        density,
        comb(axes + DENSITY_DEGREE, DENSITY_DEGREE),
        slice(0, 2 * value),
        slice(2 * value, floats),
        floats,
        axes + 3,
    )


# In the plane, as in the paper.
_, VALUE_FEATURES, DENSITY_FEATURES, _, VALUE, DENSITY, MODEL_FLOATS, NUMBERS = layout_of(2)


class Tables(NamedTuple):
    """Constants of a scenario, in the order of the struct in learn.h: first all floats, then all indices.

    The shapes are those of the plane.
    """

    scale: Floats  # (4,): L_r, L_r, L_v, L_v
    value_factor: Floats  # (216,): of σ_H, ∂σ_H/∂r, ∂σ_H/∂v, ∂²σ_H/∂v², 54 each
    pair_factor: Floats  # (120,): of A, ∂A/∂x, ∂A/∂y, V, ∂V/∂vx, ∂V/∂vy, ∂²V/∂vx², ∂²V/∂vy², 15 each
    coefficient: Floats  # (70,): of the terms [1, σ_F]; one, or multinomial
    factorial: Floats  # (70,): n! of the same terms, times their coefficient
    monomials: Floats  # (70, 64): δⁿ/n! of the scaled offsets δ of the quadrature
    kernel: Floats  # (64,): K(s, s + δ)
    wind: Floats  # (2,): v_o, m/s
    drag: float  # c0, 1/s
    half_variance: float  # σ_wind²/2, m²/s³
    c1: float
    c2: float
    c3: float
    epsilon: float  # ε, m²
    gain: float  # 1/2c3
    mu_h: float
    mu_f: float
    push: float  # μ_H c_H/2c3, of the regulariser
    kappa: float  # κ, 1/s
    arrived_squared: float  # s_dest²
    value_first: Indices  # (216,): of the 28 powers
    value_second: Indices  # (216,)
    pair_first: Indices  # (120,)
    pair_second: Indices  # (120,)
    pair_third: Indices  # (0,); in space as many as of the others
    at_position: Indices  # (70,): which A a term of [1, σ_F] has
    at_velocity: Indices  # (70,): which V
    left: Indices  # (138,): into [A, LA, V, LV], 15 each: a term's image is LA·V + A·LV
    right: Indices  # (138,)
    weight: Indices  # (494,): of the expansion of m̂ about s, term by term: which ŵ_F0,
    term: Indices  # (494,): times which of [1, σ_F]
    starts: Indices  # (71,): and where a term's products begin


def packed(tables: Tables) -> tuple[Floats, NDArray[np.int32]]:
    """Pack all floats into one array and all indices into another."""
    split = Tables._fields.index("value_first")
    floats, indices = ([np.ravel(field) for field in part] for part in (tables[:split], tables[split:]))
    return np.concatenate(floats).astype(np.float64), np.concatenate(indices).astype(np.int32)
