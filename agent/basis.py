"""Polynomial features σ_H and σ_F of the two networks, with exact derivatives.

Both are monomials of the scaled state s̄ = [x/L_r, y/L_r, vx/L_v, vy/L_v] with coefficient one; the paper's raw
metres and multinomial coefficients make the LMS step μ‖∇e‖² < 2 impossible. Every function is row-wise: row i of
the result depends on row i of the arguments only, to the last bit.
"""

from itertools import product
from math import perm

import numpy as np
from numpy.typing import NDArray

from agent.weights import DENSITY_FEATURES, VALUE_FEATURES
from swarm import state
from swarm.scenario import Learner

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

VALUE_DEGREE = 6
DENSITY_DEGREE = 4
_POWERS = VALUE_DEGREE + 1  # 1, u, u² … u⁶ of each coordinate
_PER_AXIS = VALUE_FEATURES // state.AXES


def _value_exponents() -> NDArray[np.intp]:
    """Exponents of σ_H, (54, 4): axis x then y, lexicographic in (position, velocity) within an axis."""
    rows = []
    for position, velocity in ((state.X, state.VX), (state.Y, state.VY)):
        for i, j in product(range(VALUE_DEGREE + 1), repeat=2):
            if 1 <= i + j <= VALUE_DEGREE:
                row = [0] * state.SIZE
                row[position], row[velocity] = i, j
                rows.append(row)
    return np.array(rows)


def _density_exponents() -> NDArray[np.intp]:
    """Exponents of σ_F, (69, 4), lexicographic: the terms of degree 1…4 in four variables."""
    grid = product(range(DENSITY_DEGREE + 1), repeat=state.SIZE)
    return np.array([row for row in grid if 1 <= sum(row) <= DENSITY_DEGREE])


VALUE_EXPONENTS = _value_exponents()
DENSITY_EXPONENTS = _density_exponents()
assert len(VALUE_EXPONENTS) == VALUE_FEATURES
assert len(DENSITY_EXPONENTS) == DENSITY_FEATURES


def scales(learner: Learner) -> Floats:
    """[L_r, L_r, L_v, L_v]."""
    position, velocity = learner.position_scale, learner.velocity_scale
    return np.array([position, position, velocity, velocity])


class Powers:
    """1, u, u² … u⁶ of each scaled coordinate u."""

    def __init__(self, learner: Learner) -> None:
        self._scale = scales(learner)

    def __call__(self, states: Floats) -> Floats:
        """States `(..., 4)` to powers `(..., 4, 7)`."""
        powers = np.empty((*states.shape, _POWERS))
        powers[..., 0] = 1.0
        powers[..., 1:] = (states / self._scale)[..., None]
        return np.multiply.accumulate(powers, axis=-1, out=powers)


class ValueBasis:
    """σ_H and its derivatives. A feature belongs to one axis, so it has one derivative by position, one by velocity."""

    def __init__(self, learner: Learner) -> None:
        first, second, factor = [], [], []
        scale = scales(learner)
        for by_position, by_velocity in ((0, 0), (1, 0), (0, 1), (0, 2)):
            for row in VALUE_EXPONENTS:
                axis = state.X if row[state.X] or row[state.VX] else state.Y
                i, j = row[axis], row[axis + state.VX]
                i_left, j_left = i - by_position, j - by_velocity
                falling = perm(i, by_position) * perm(j, by_velocity)
                inside = i_left >= 0 and j_left >= 0
                first.append(axis * _POWERS + (i_left if inside else 0))
                second.append((axis + state.VX) * _POWERS + (j_left if inside else 0))
                unit = scale[axis] ** by_position * scale[axis + state.VX] ** by_velocity
                factor.append(falling / unit if inside else 0.0)
        self.first: Indices = np.array(first)
        self.second: Indices = np.array(second)
        self.factor: Floats = np.array(factor)

    def __call__(self, powers: Floats) -> Floats:
        """Powers to `(..., 4, 2, 27)`: [σ, ∂σ/∂r, ∂σ/∂v, ∂²σ/∂v²] of the features of axis x and of axis y."""
        flat = powers.reshape(*powers.shape[:-2], -1)
        values = flat.take(self.first, axis=-1)
        values *= flat.take(self.second, axis=-1)
        values *= self.factor
        return values.reshape(*flat.shape[:-1], 4, state.AXES, _PER_AXIS)


class DensityBasis:
    """σ_F, and its image under the operator of the FPK equation.

    A term x̄^a ȳ^b v̄x^c v̄y^d is a product of a position pair (a, b) and a velocity pair (c, d), fifteen of each, and
    the operator acts on a product by the product rule: on pairs first, then on terms. The constant comes first, so
    the seventy terms are [1, σ_F].
    """

    def __init__(self, learner: Learner, diffusion: float) -> None:
        """`diffusion`: σ_wind, m/s/√s."""
        scale = scales(learner)
        pairs = [(i, j) for i, j in product(range(DENSITY_DEGREE + 1), repeat=2) if i + j <= DENSITY_DEGREE]
        count = len(pairs)
        number = {pair: k for k, pair in enumerate(pairs)}
        first, second, factor = [], [], []
        position, velocity = state.X, state.VX
        for base, by_first, by_second in (
            (position, 0, 0), (position, 1, 0), (position, 0, 1),
            (velocity, 0, 0), (velocity, 1, 0), (velocity, 0, 1), (velocity, 2, 0), (velocity, 0, 2),
        ):  # fmt: skip
            for i, j in pairs:
                inside = i >= by_first and j >= by_second
                falling = perm(i, by_first) * perm(j, by_second)
                first.append(base * _POWERS + max(i - by_first, 0))
                second.append((base + 1) * _POWERS + max(j - by_second, 0))
                factor.append(falling / scale[base] ** (by_first + by_second) if inside else 0.0)
        self.first: Indices = np.array(first)
        self.second: Indices = np.array(second)
        self.factor: Floats = np.array(factor)
        self._count = count
        self._half_variance = 0.5 * diffusion**2
        terms = [(0, 0, 0, 0), *DENSITY_EXPONENTS.tolist()]
        at_position = np.array([number[a, b] for a, b, _, _ in terms])
        at_velocity = np.array([number[c, d] for _, _, c, d in terms])
        self.at_position, self.at_velocity = at_position, at_velocity
        # Into [A, LA, V, LV]: pairs and their images; a term's image is LA·V + A·LV.
        self.left: Indices = np.concatenate([count + at_position[1:], at_position[1:]])
        self.right: Indices = np.concatenate([2 * count + at_velocity[1:], 3 * count + at_velocity[1:]])

    def pairs(self, powers: Floats) -> Floats:
        """`(..., 8, 15)`: position pairs A, ∂A/∂x, ∂A/∂y, velocity pairs V, ∂V/∂vx, ∂V/∂vy, ∂²V/∂vx², ∂²V/∂vy²."""
        flat = powers.reshape(*powers.shape[:-2], -1)
        values = flat.take(self.first, axis=-1)
        values *= flat.take(self.second, axis=-1)
        values *= self.factor
        return values.reshape(*flat.shape[:-1], 8, self._count)

    def terms(self, pairs: Floats) -> Floats:
        """[1, σ_F], `(..., 70)`."""
        return pairs[..., 0, :].take(self.at_position, axis=-1) * pairs[..., 3, :].take(self.at_velocity, axis=-1)

    def operator(self, pairs: Floats, drift: Floats, divergence: Floats) -> Floats:
        """∇_{ŵF0} e_F = σ_F ∇·b + [∇σ_F] b − ½ [tr(GGᵀ Hess σ_F)], `(..., 69)`.

        Args:
            pairs: of the states, `(..., 8, 15)`.
            drift: b, `(..., 4)`, m/s and m/s².
            divergence: ∇·b, `(...)`, 1/s.
        """
        factors = np.empty((*drift.shape[:-1], 8, 1))
        factors[..., 0, 0] = divergence
        factors[..., 1:3, 0] = drift[..., state.POSITION]  # ṙ of the state, in the order of the derivatives
        factors[..., 4:6, 0] = drift[..., state.VELOCITY]
        factors[..., 6:8, 0] = -self._half_variance
        factors[..., 3, 0] = 0.0
        images = factors * pairs
        blocks = np.empty((*drift.shape[:-1], 4, self._count))
        blocks[..., 0, :] = pairs[..., 0, :]
        blocks[..., 1, :] = images[..., 0, :] + images[..., 1, :] + images[..., 2, :]
        blocks[..., 2, :] = pairs[..., 3, :]
        blocks[..., 3, :] = images[..., 4, :] + images[..., 5, :] + images[..., 6, :] + images[..., 7, :]
        flat = blocks.reshape(*blocks.shape[:-2], -1)
        products = flat.take(self.left, axis=-1)
        products *= flat.take(self.right, axis=-1)
        return products[..., :DENSITY_FEATURES] + products[..., DENSITY_FEATURES:]
