"""Layout of the model of a mean-field learner, and the constants of its step; `learn.h` has the same in C.

A model is one row of floats, [ŵ_H0 (54), ŵ_H1 (54), ŵ_F0 (69), ŵ_F1 (69)]. A *power* is one of 1, u, u² … u⁶ of a
scaled coordinate u; four coordinates make 28. A *feature* is a product of two powers and a factor.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Floats

Indices = NDArray[np.intp]

DIMENSIONS = 2  # axes of a state of this layout; the counts below follow from it
VALUE_FEATURES = 54  # M_H: terms of σ_H
DENSITY_FEATURES = 69  # M_F: terms of σ_F
VALUE = slice(0, 2 * VALUE_FEATURES)
DENSITY = slice(VALUE.stop, VALUE.stop + 2 * DENSITY_FEATURES)
MODEL_FLOATS = DENSITY.stop  # 246
NUMBERS = DIMENSIONS + 3  # results of a step: [a_x, a_y, e_H, e_F, φ_G]


class Tables(NamedTuple):
    """Constants of a scenario, in the order of the struct in learn.h: first all floats, then all indices."""

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
