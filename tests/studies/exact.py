"""What is known exactly: the mean of an LMS filter, the control law where the problem is linear-quadratic, and the FPK
operator on a Gaussian."""

from dataclasses import dataclass
from itertools import product
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from meanflock.agent.controllers.mean_field.tables import DENSITY_EXPONENTS, VALUE_EXPONENTS, scales, tables
from meanflock.kernels.mean_field import features, fpk
from meanflock.kernels.mean_field.layout import DENSITY_FEATURES, VALUE_FEATURES
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario

Floats = NDArray[np.float64]


def mean_deviation(r: Floats, start: Floats, mu: float, steps: int) -> Floats:
    """E[w̃(n)] = (I − μR)ⁿ w̃(0), `(M,)`."""
    values, vectors = np.linalg.eigh(r)
    return vectors @ ((1.0 - mu * values) ** steps * (vectors.T @ start))


# -- the control law where the problem is linear-quadratic -----------------------------------------------------------


def value_weights(scenario: Scenario, matrix: Floats, linear: Floats) -> Floats:
    """[ŵ_H0, 0], `(2, 54)`, of ψ(s) = sᵀ diag-per-axis(P) s + ℓᵀs, so that the learner's own code can be asked.

    Args:
        matrix: P of one axis' (position, velocity), (2, 2), symmetric; the same for both axes. linear: ℓ, (4,).
    """
    weights = np.zeros((2, VALUE_FEATURES))
    scale = scales(scenario.learner)
    number = {tuple(row): k for k, row in enumerate(VALUE_EXPONENTS.tolist())}

    def add(exponents: tuple[int, ...], coefficient: float) -> None:
        weights[0, number[exponents]] += coefficient * float(np.prod(scale ** np.array(exponents)))

    unit = np.eye(state.SIZE, dtype=int)
    for k in range(state.SIZE):
        add(tuple(unit[k].tolist()), float(linear[k]))
    for position, velocity in ((state.X, state.VX), (state.Y, state.VY)):
        axis = (position, velocity)
        for i, j in product(range(2), repeat=2):
            add(tuple((unit[axis[i]] + unit[axis[j]]).tolist()), float(matrix[i, j]))
    return weights


def regulator(scenario: Scenario, q: Floats) -> Floats:
    """P of one axis, `(2, 2)`: the algebraic Riccati equation of min ∫ sᵀQs + c3 a², with the drag, without wind.

    Args:
        q: Q of one axis, (2, 2).
    """
    drag = scenario.wind.drag
    a, b = np.array([[0.0, 1.0], [0.0, -drag]]), np.array([[0.0], [1.0]])
    return linalg.solve_continuous_are(a, b, q, np.array([[scenario.cost.c3]]))


@dataclass(frozen=True, slots=True)
class Cruise:
    """The exact stationary solution ψ = q v² + p v + rate·t of the paper's own problem on a line.

    Flying the x axis on its positive side, v·r/‖r‖ is just v, so without φ_G the problem is linear-quadratic.
    q: s²/m² of cost. p: s/m. rate: ψ̇, per second, minus the lowest mean cost there is. speed: vx it settles at, m/s.
    """

    q: float
    p: float
    rate: float
    speed: float


def cruise(scenario: Scenario) -> Cruise:
    """Solves the HJB equation of the line, term by term in v; wind along x."""
    cost, drag, wind = scenario.cost, scenario.wind.drag, scenario.wind.mean[0]
    q = cost.c3 * (sqrt(drag**2 + cost.c1 / cost.c3) - drag)
    p = (1.0 + 2.0 * drag * wind * q) / (drag + q / cost.c3)
    rate = p**2 / (4.0 * cost.c3) - drag * wind * p - scenario.wind.sigma**2 * q
    speed = (drag * wind - p / (2.0 * cost.c3)) / (drag + q / cost.c3)
    return Cruise(q, p, rate, speed)


# -- the FPK operator on an exact Gaussian ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LinearFlow:
    """ds = (A s + b) dt + G dW of one UAV under a linear policy a = −K s. matrix: A (4, 4). offset: b (4,).

    diffusion: GGᵀ (4, 4).
    """

    matrix: Floats
    offset: Floats
    diffusion: Floats


def closed_loop(scenario: Scenario, gain: Floats) -> LinearFlow:
    """The paper's dynamics under a = −K s; K `(2, 4)`, 1/s² and 1/s."""
    matrix, offset, diffusion = np.zeros((4, 4)), np.zeros(4), np.zeros((4, 4))
    matrix[state.POSITION, state.VELOCITY] = np.eye(2)
    matrix[state.VELOCITY, :] = -gain
    matrix[state.VELOCITY, state.VELOCITY] -= scenario.wind.drag * np.eye(2)
    offset[state.VELOCITY] = scenario.wind.drag * np.array(scenario.wind.mean)
    diffusion[state.VELOCITY, state.VELOCITY] = scenario.wind.sigma**2 * np.eye(2)
    return LinearFlow(matrix, offset, diffusion)


def stationary(flow: LinearFlow) -> tuple[Floats, Floats]:
    """Mean (4,) and covariance (4, 4) of the Gaussian the flow settles in; A must be stable."""
    mean = np.asarray(-np.linalg.solve(flow.matrix, flow.offset), dtype=np.float64)
    return mean, linalg.solve_continuous_lyapunov(flow.matrix, -flow.diffusion)


def gaussian_residual(flow: LinearFlow, mean: Floats, covariance: Floats, states: Floats) -> Floats:
    """ṁ + m∇·b + bᵀ∇m − ½tr(GGᵀ Hess m) of the Gaussian that moves with the flow, over its peak; zero, `(S,)`.

    The moments obey μ̇ = Aμ + b and Σ̇ = AΣ + ΣAᵀ + GGᵀ, so the Gaussian is the exact density at every time, not only
    once it is stationary.

    Args:
        mean: (4,). covariance: (4, 4). states: (S, 4).
    """
    inverse = np.linalg.inv(covariance)
    z = (states - mean) @ inverse
    density = np.exp(-0.5 * ((states - mean) * z).sum(axis=-1))
    rate = flow.matrix @ covariance + covariance @ flow.matrix.T + flow.diffusion
    change = z @ (flow.matrix @ mean + flow.offset) + 0.5 * ((z @ rate) * z).sum(axis=-1)
    change -= 0.5 * np.trace(inverse @ rate)
    drift = states @ flow.matrix.T + flow.offset
    advected = np.trace(flow.matrix) - (drift * z).sum(axis=-1)
    spread = 0.5 * (((z @ flow.diffusion) * z).sum(axis=-1) - np.trace(flow.diffusion @ inverse))
    return density * (change + advected - spread)


def gaussian_weights(scenario: Scenario, covariance: Floats) -> Floats:
    """ŵ_F0, `(69,)`: exp(−½ sᵀΣ⁻¹s) − 1 about the origin, expanded to the fourth order σ_F holds."""
    inverse = np.linalg.inv(covariance)
    scale = scales(scenario.learner)
    number = {tuple(row): k for k, row in enumerate(DENSITY_EXPONENTS.tolist())}
    unit = np.eye(state.SIZE, dtype=int)
    quadratic = {(i, j): 0.5 * float(inverse[i, j]) for i, j in product(range(state.SIZE), repeat=2) if inverse[i, j]}
    weights = np.zeros(DENSITY_FEATURES)

    def add(exponents: NDArray[np.intp], coefficient: float) -> None:
        weights[number[tuple(exponents.tolist())]] += coefficient * float(np.prod(scale**exponents))

    for (i, j), first in quadratic.items():
        add(unit[i] + unit[j], -first)
        for (k, m), second in quadratic.items():
            add(unit[i] + unit[j] + unit[k] + unit[m], 0.5 * first * second)
    return weights


def operator_residual(scenario: Scenario, flow: LinearFlow, weights: Floats, states: Floats) -> Floats:
    """e_F of m̂ = 1 + ŵᵀσ_F at rest in time under the flow, from the learner's own basis, `(S,)`, 1/s.

    σ_F has no constant, so the operator's image of the 1, which is ∇·b, is added by hand.
    """
    t = tables(scenario)
    pairs = features.pairs(t, features.powers(t, states))
    divergence = np.full(len(states), np.trace(flow.matrix))
    return fpk.operator(t, pairs, states @ flow.matrix.T + flow.offset, divergence) @ weights + divergence
