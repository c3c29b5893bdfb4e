"""The two networks of a mean-field method: their features and constants, initial weights, and one step.

Features are monomials of the scaled state s̄ = [x/L_r, y/L_r, vx/L_v, vy/L_v], with coefficient one or, by
`learner.multinomial`, those of the powers the paper prints: (1 + x̄ + v̄x)⁶ has 6!/(i! j! (6 − i − j)!) before x̄ⁱv̄xʲ.
With the paper's raw metres no choice of coefficients satisfies the LMS condition μ‖∇e‖² < 2.

The paper starts the density from a sum of Dirac impulses with ŵ_F0 = 0. F̂ is homogeneous in ŵ_F, so a learner that
starts at zero never learns. Here ŵ_F0(0) is a ridge least-squares fit of m̂ to a Gaussian mixture over the initial
states, which all UAVs know before take-off. All arrays are rows.
"""

import sys
from functools import lru_cache
from itertools import product
from math import factorial, perm, prod
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.kernels.mean_field import features, interaction
from meanflock.kernels.mean_field.features import POWERS
from meanflock.kernels.mean_field.interaction import empirical
from meanflock.kernels.mean_field.layout import DENSITY_DEGREE, VALUE_DEGREE, Tables, layout_of
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario, mean_field
from meanflock.swarm.scenario.tables import Space, Wind
from meanflock.swarm.seeds import generator
from meanflock.swarm.state import Floats

Indices = NDArray[np.intp]
Products = tuple[Indices, Floats]  # which of the powers each factor of a product is, and a factor more
Power = tuple[int, int, int]  # coordinate, exponent, order of the derivative by the coordinate


class Keys(NamedTuple):
    """All of a scenario that its tables depend on."""

    learner: mean_field.LearnerTable
    cost: mean_field.Cost
    wind: Wind
    density: mean_field.Density
    radius: float  # of the destination, m
    space: Space


def value_exponents(axes: int) -> Indices:
    """Exponents of σ_H, (54, 4): axis x then y, lexicographic in (position, velocity) within an axis."""
    rows = []
    for axis in range(axes):
        for i, j in product(range(VALUE_DEGREE + 1), repeat=2):
            if 1 <= i + j <= VALUE_DEGREE:
                row = [0] * (2 * axes)
                row[axis], row[axes + axis] = i, j
                rows.append(row)
    return np.array(rows)


def density_exponents(axes: int) -> Indices:
    """Exponents of σ_F, (69, 4), lexicographic: the terms of degree 1…4 in four variables."""
    grid = product(range(DENSITY_DEGREE + 1), repeat=2 * axes)
    return np.array([row for row in grid if 1 <= sum(row) <= DENSITY_DEGREE])


def scales(learner: mean_field.LearnerTable, axes: int) -> Floats:
    """Scales [L_r, L_r, L_v, L_v] of a state."""
    return np.repeat([learner.position_scale, learner.velocity_scale], axes)


def standard_nodes(axes: int) -> Floats:
    """The 64 scrambled-Sobol points of the standard normal in 2d dimensions, `(64, 2d)`; a fixed table for each d."""
    name = "nodes.csv" if axes == state.PLANE else "nodes_in_space.csv"
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    return np.array([[float(cell) for cell in line.split(",")] for line in text.splitlines()])


def offsets(spread: mean_field.Density, axes: int) -> Floats:
    """Offsets δ of the quadrature's nodes from the UAV, `(64, 2d)`."""
    return standard_nodes(axes) * np.repeat([spread.node_position_std, spread.node_velocity_std], axes)


def keys(scenario: Scenario) -> Keys:
    """Returns the parts of a scenario that its tables depend on."""
    learner = msgspec.structs.replace(scenario.learner, position_scale=scenario.position_scale_m)
    parts = learner, scenario.cost, scenario.wind, scenario.density
    return Keys(*parts, scenario.destination.radius, scenario.space)


def tables(scenario: Scenario) -> Tables:
    """All tables of a scenario."""
    return tables_of(keys(scenario))


@lru_cache(maxsize=4)  # processes that are forked from one have those of their flight already
def tables_of(given: Keys) -> Tables:
    """All tables, by what they depend on."""
    learner, cost, wind, density, radius, space = given
    axes = space.dimensions
    scale, nodes = scales(learner, axes), offsets(density, axes)
    terms = np.concatenate([np.zeros((1, 2 * axes), dtype=np.intp), density_exponents(axes)])
    factorials = np.array([float(prod(map(factorial, term))) for term in terms.tolist()])
    monomials = ((nodes / scale)[None, :, :] ** terms[:, None, :]).prod(axis=-1)
    (value_first, value_second), value_factor = _value_products(scale, learner.multinomial)
    grid = product(range(DENSITY_DEGREE + 1), repeat=axes)
    pairs = [exponents for exponents in grid if sum(exponents) <= DENSITY_DEGREE]
    pair_places, pair_factor = _pair_products(scale, pairs)
    number = {pair: k for k, pair in enumerate(pairs)}
    at_position = np.array([number[tuple(term)] for term in state.position(terms).tolist()])
    at_velocity = np.array([number[tuple(term)] for term in state.velocity(terms).tolist()])
    count = len(pairs)
    coefficient = np.array(
        [_coefficient(DENSITY_DEGREE, term) if learner.multinomial else 1.0 for term in terms.tolist()]
    )
    weight, term, starts = _expansion(terms)
    gain = 1.0 / (2.0 * cost.c3)
    return Tables(
        scale=scale,
        value_factor=value_factor,
        pair_factor=pair_factor,
        coefficient=coefficient,
        factorial=factorials * coefficient,
        monomials=np.ascontiguousarray(monomials / factorials[:, None]),
        kernel=interaction.kernel(state.velocity(nodes), state.position(nodes), cost.epsilon, cost.beta),
        wind=space.vector(wind.mean),
        drag=wind.drag,
        half_variance=0.5 * wind.sigma**2,
        c1=cost.c1,
        c2=cost.c2,
        c3=cost.c3,
        epsilon=cost.epsilon,
        gain=gain,
        mu_h=learner.mu_h,
        mu_f=learner.mu_f,
        push=learner.mu_h * learner.c_h * gain,
        kappa=learner.kappa,
        arrived_squared=radius**2,
        value_first=value_first,
        value_second=value_second,
        pair_first=pair_places[0],
        pair_second=pair_places[1],
        pair_third=pair_places[2] if axes == state.SPACE else np.zeros(0, dtype=np.intp),
        at_position=at_position,
        at_velocity=at_velocity,
        left=np.concatenate([count + at_position[1:], at_position[1:]]),
        right=np.concatenate([2 * count + at_velocity[1:], 3 * count + at_velocity[1:]]),
        weight=weight,
        term=term,
        starts=starts,
    )


def _coefficient(degree: int, exponents: list[int]) -> float:
    """Multinomial coefficient of a term in (1 + its variables)^`degree`."""
    return float(factorial(degree) // prod(map(factorial, [*exponents, degree - sum(exponents)])))


def _value_products(scale: Floats, multinomial: bool) -> Products:
    """Products that make σ_H, ∂σ_H/∂r, ∂σ_H/∂v and ∂²σ_H/∂v². Each feature belongs to one axis."""
    features, axes = [], len(scale) // 2
    for by_position, by_velocity in ((0, 0), (1, 0), (0, 1), (0, 2)):
        for row in value_exponents(axes).tolist():
            axis = next(axis for axis in range(axes) if row[axis] or row[axes + axis])
            powers = [(axis, row[axis], by_position), (axes + axis, row[axes + axis], by_velocity)]
            features.append((powers, _coefficient(VALUE_DEGREE, row) if multinomial else 1.0))
    return _products(scale, features)


def _pair_products(scale: Floats, pairs: list[tuple[int, ...]]) -> Products:
    """Products that make the pairs of positions, then of velocities, each with the derivatives of the FPK operator."""
    axes = len(scale) // 2
    none, single = [0] * axes, np.eye(axes, dtype=int).tolist()
    double = (2 * np.eye(axes, dtype=int)).tolist()
    derivatives = [(0, orders) for orders in (none, *single)] + [(axes, orders) for orders in (none, *single, *double)]
    return _products(
        scale,
        [
            ([(at + axis, exponents[axis], orders[axis]) for axis in range(axes)], 1.0)
            for at, orders in derivatives
            for exponents in pairs
        ],
    )


def _products(scale: Floats, features: list[tuple[list[Power], float]]) -> Products:
    """Products that make features, each of some powers and a coefficient."""
    places, factors = [], []
    for powers, coefficient in features:
        inside = all(exponent >= by for _, exponent, by in powers)
        places.append([axis * POWERS + (exponent - by if inside else 0) for axis, exponent, by in powers])
        falling = prod(perm(exponent, by) for _, exponent, by in powers)
        unit = prod(scale[axis] ** by for axis, _, by in powers)
        factors.append(coefficient * (falling / unit) if inside else 0.0)
    return np.array(places).T, np.array(factors)


def _expansion(terms: Indices) -> tuple[Indices, Indices, Indices]:
    """Indices of the expansion of m̂ about a state: weights n + r, terms r, and the first index of each term n."""
    degree = terms.sum(axis=-1)
    together = np.add.outer(degree, degree)  # of n + r: a term of m̂ if it is one of the 69
    n, r = np.nonzero((together > 0) & (together <= DENSITY_DEGREE))
    place = (terms * (DENSITY_DEGREE + 1) ** np.arange(terms.shape[1])[::-1]).sum(axis=-1)  # ascending, as terms are
    return np.searchsorted(place, place[n] + place[r]) - 1, r, np.searchsorted(n, np.arange(len(terms) + 1))


_ONLY_IN_A_LIST = 2  # references to an object that only a list has, while `sys.getrefcount` counts them
_BLOCK = 2**17  # pairs of point and centre at a time; bounds the memory at 8 MiB
_MANY = 4096  # centres of a mixture above which each point meets those near it, and as many centres show the peak
_CENTRES, _CELLS = 1024, 64  # initial states of a fit, and cells of goals with a fit each, of as many UAVs
_STRIP = 16  # rows of a symmetric matrix at a time
_FAR = 9.0  # bandwidths: a Gaussian is less than a rounding error of its peak beyond


class MeanFieldLearner:
    """Algorithm 1 (hjb) and the local part of Algorithms 2 and 3 (all others)."""

    def __init__(self, scenario: Scenario, *, learns_density: bool = True) -> None:
        self._scenario = scenario
        self._layout = layout_of(scenario.dimensions)
        self._learns_density = learns_density
        self._constants = tables(scenario)
        self._prepared = kernels.prepare(self._constants)
        self._written: list[Floats] = []  # weights of the last steps

    def init(self, rows: int, initial_states: Floats) -> Floats:
        """Weights at take-off, `(rows, 246)`, in space `(rows, 580)`.

        Every UAV fits one density to the initial states of all, `(N, 2d)`.
        """
        weights = np.zeros((rows, self._layout.floats))
        if self._learns_density:
            plan = np.ascontiguousarray(initial_states, dtype=np.float64)
            weights[:, self._layout.density] = _fit_of_plan(keys(self._scenario), self._scenario.seed, plan.tobytes())
        return weights

    def init_to(self, goals: Floats, uavs: NDArray[np.intp], initial_states: Floats) -> Floats:
        """Weights at take-off of some UAVs (M,) that fly to goals of their own, of all `goals` (N, 2d); `(M, 246)`.

        A fit is to the initial states relative to a goal. UAVs of the same goal share it. Of more than 4,096 UAVs,
        those whose goals are near share a fit to some of the initial states, relative to the mean of these goals.
        """
        if len(goals) <= _MANY:
            places, place = np.unique(goals, axis=0, return_inverse=True)
        else:
            places, place = _cells(goals)
            initial_states = initial_states[np.linspace(0, len(goals) - 1, _CENTRES).astype(np.intp)]
        found, row = np.unique(place.reshape(-1)[uavs], return_inverse=True)
        fitted = [self.init(1, initial_states - goal) for goal in places[found]]
        weights: Floats = np.concatenate([np.zeros((0, self._layout.floats)), *fitted])[row]
        return weights

    def refit(self, weights: Floats, rows: NDArray[np.intp], known_states: Floats) -> Floats:
        """The weights (M, 246), with the density of some rows fitted to the states that they know, (M, N, 4)."""
        refitted, count, start = weights.copy(), self._layout.density_features, self._layout.density.start
        for row in rows.tolist():
            fitted = fit(self._scenario.density, self._scenario.seed, self._constants, known_states[row])
            refitted[row, start : start + count] = fitted[:count]
        return refitted

    def step(self, weights: Floats, states: Floats, known_states: Floats | None) -> tuple[Floats, Floats]:
        """Update each network once; returns the new weights, and numbers (M, d + 3), [a, e_H, e_F, φ_G].

        Args:
            weights: (M, floats). states: (M, 2d). known_states: (M, N, 2d), the states known to each row, for hjb only.
        """
        around, cost = None, self._scenario.cost
        if not self._learns_density:
            if known_states is None:
                raise ValueError("hjb needs the states known to its rows")
            with np.errstate(over="ignore", invalid="ignore"):
                around = known_states if cost.beta == 1.0 else empirical(states, known_states, cost.epsilon, cost.beta)
        stepped, numbers = self._room(weights.shape), np.empty((len(weights), self._layout.numbers))
        kernels.learn(self._prepared, states, np.ascontiguousarray(weights), around, stepped, numbers)
        return stepped, numbers

    def _room(self, shape: tuple[int, ...]) -> Floats:
        """An array to be written: that of an earlier step if only this learner still has it, else a new one.

        The memory of new arrays is cleared first, which takes as long as a third of a step of thousands of rows.
        """
        for place in range(len(self._written)):
            if sys.getrefcount(self._written[place]) == _ONLY_IN_A_LIST and self._written[place].shape == shape:
                return self._written[place]
        self._written = [*self._written[-1:], np.empty(shape)]
        return self._written[-1]


def _cells(goals: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Mean goals (K, 2d) of the cells of a grid over goals (N, 2d), and the number of the cell of each goal, (N,)."""
    places = state.position(goals)
    side = round(_CELLS ** (1 / places.shape[1]))
    low, width = places.min(axis=0), np.ptp(places, axis=0)
    index = np.minimum(side * (places - low) / np.where(width > 0.0, width, 1.0), side - 1).astype(np.intp)
    number = np.ravel_multi_index(tuple(index.T), (side,) * places.shape[1])
    _, cell, count = np.unique(number, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(cell, weights=column) / count for column in places.T], axis=-1)
    return state.at_rest(means), cell


def mixture(points: Floats, centres: Floats, bandwidth: Floats) -> Floats:
    """Gaussian mixture over `centres` (N, 2d) with std `bandwidth` (2d,), its peak over the centres scaled to one.

    Of more than 4,096 centres, those beyond nine bandwidths along x are left out, and the peak is that over 4,096 of
    them, evenly spaced along x: so time grows more slowly than N.

    Args:
        points: (S, 2d). Returns: (S,).
    """
    if len(centres) <= _MANY:
        return _kernel_sums(points, centres, bandwidth) / _kernel_sums(centres, centres, bandwidth).max()
    centres = centres[np.argsort(centres[:, 0], kind="stable")]
    shown = centres[np.linspace(0, len(centres) - 1, _MANY).astype(np.intp)]
    ends = np.searchsorted(
        centres[:, 0], np.concatenate([points, shown])[:, :1] + [-_FAR * bandwidth[0], _FAR * bandwidth[0]]
    )
    sums = np.array(
        [
            _kernel_sums(at[None], centres[first:end], bandwidth)[0]
            for at, (first, end) in zip((*points, *shown), ends.tolist(), strict=True)
        ]
    )
    return sums[: len(points)] / sums[len(points) :].max()


def _kernel_sums(points: Floats, centres: Floats, bandwidth: Floats) -> Floats:
    """Sums (S,) at points (S, 2d) of Gaussians of height 1 around centres (N, 2d)."""
    rows = max(1, _BLOCK // max(1, len(centres)))
    sums = np.empty(len(points))
    for start in range(0, len(points), rows):
        block = points[start : start + rows]
        squared = np.zeros((len(block), len(centres)))
        for axis, width in enumerate(bandwidth):  # one at a time: a sum over the last axis is slow
            z = block[:, axis, None] - centres[:, axis]
            z /= width
            z *= z
            squared += z
        squared *= -0.5
        sums[start : start + rows] = np.exp(squared, out=squared).sum(axis=-1)
    return sums


@lru_cache(maxsize=_CELLS)  # processes that are forked from one have the fits of their flight already
def _fit_of_plan(given: Keys, seed: int, plan: bytes) -> Floats:
    """`fit` to the initial states whose bytes are `plan`."""
    states = np.frombuffer(plan).reshape(-1, 2 * given.space.dimensions)
    fitted = fit(given.density, seed, tables_of(given), states)
    fitted.flags.writeable = False
    return fitted


def fit(spread: mean_field.Density, seed: int, constants: Tables, initial_states: Floats) -> Floats:
    """[ŵ_F0(0), 0], `(138,)`: min mean (ŵᵀσ_F(s) − m(s))² + ridge ‖ŵ‖² over fixed sample points.

    Every UAV of a run computes the same bits: the sample points come from the scenario's seed, and the normal
    equations are summed without BLAS, whose order depends on the number of cores.

    Args:
        constants: of the scenario. seed: of the scenario. initial_states: (N, 2d).
    """
    axes = state.axes(initial_states)
    bandwidth = np.repeat([spread.position_bandwidth, spread.velocity_bandwidth], axes)
    draw = generator(seed, "density-fit")
    chosen = draw.integers(len(initial_states), size=spread.near_samples)
    near = initial_states[chosen] + 2.0 * bandwidth * draw.standard_normal((spread.near_samples, 2 * axes))
    box = constants.scale * draw.uniform(-1.0, 1.0, (spread.box_samples, 2 * axes))
    points = np.concatenate([near, box])
    sigma = features.density(constants, points)[:, 1:]
    target = mixture(points, initial_states, bandwidth)
    normal = _squared(sigma) / len(points)
    right = np.einsum("sk,s->k", sigma, target) / len(points)
    count = len(right)
    weights = np.zeros(2 * count)
    weights[:count] = np.linalg.solve(normal + spread.ridge * np.eye(count), right)
    return weights


def _squared(sigma: Floats) -> Floats:
    """σᵀσ of σ (S, K), (K, K), each sum in the order of the rows. It is symmetric, so half of it is computed."""
    size = sigma.shape[1]
    found = np.empty((size, size))
    for first in range(0, size, _STRIP):
        rows = slice(first, first + _STRIP)
        strip = np.einsum("sk,sl->kl", sigma[:, rows], sigma[:, first:])
        found[rows, first:], found[first:, rows] = strip, strip.T
    return found
