"""Least-squares policy iteration (Lagoudakis and Parr 2003) for a point that follows a trajectory, by many rows.

An axis has the error e = (p, v), m and m/s, to the trajectory and the input u, m/s², on top of its acceleration. The
policy is u = −k1 p − k2 v − k3, with k1 and k2 of both axes and a k3 for each; the cost of a tick p² + ½v² + ½u².
Its discounted sum from (e, u) on is a quadratic function w·φ of 14 features, and so is that of the policy which is best
in view of it. Two matrices keep all that was seen, whatever the policy was: M1 = Σ φφᵀ and M2 = Σ φ ψ(e′)ᵀ, ψ being
the 9 features of a state, from which those of the next (e′, u′) follow for any policy, φ′ = L ψ(e′).
"""

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.elimination import product, solve
from meanflock.swarm.state import AXES, Floats

GAINS = 4  # k1 1/s², k2 1/s, k3 along x and y m/s²
PAIRS, STATES = 14, 9  # features of (e, u) and of e
RIDGE = 1e-7
ITERATIONS = 15
SETTLED = 1e-6  # a change of the gains below it ends the iteration
LEAST_CURVATURE = 1e-6  # of the value along u; less is no minimum
LOWEST, HIGHEST = np.array([0.02, 0.1, -3.0, -3.0]), np.array([10.0, 10.0, 3.0, 3.0])  # gains that are flown

_P2, _V2, _U2, _PV, _PU, _VU = range(6)  # of both axes; then p, v, u and 1 of each
_COST = np.zeros(PAIRS)
_COST[[_P2, _V2, _U2]] = 1.0, 0.5, 0.5


def tracking(error: Floats) -> Floats:
    """How far off the trajectory: ‖p‖² + ½‖v‖², `(M,)`, of errors (M, 2 axes, 2)."""
    each = error[..., 0] ** 2 + 0.5 * error[..., 1] ** 2
    total: Floats = each[..., 0] + each[..., 1]
    return total


def inputs(gains: Floats, error: Floats) -> Floats:
    """u of the policies (M, 4) at errors (M, 2 axes, 2), `(M, 2)` m/s²; gains beyond their bounds count as these."""
    k = np.clip(gains, LOWEST, HIGHEST)
    return -k[:, :1] * error[..., 0] - k[:, 1:2] * error[..., 1] - k[:, 2:]


def seen(error: Floats, given: Floats, then: Floats) -> tuple[Floats, Floats]:
    """What a tick adds to M1 and M2, `(M, 14, 14)` and `(M, 14, 9)`.

    Args:
        error, then: (M, 2 axes, 2) the errors before and after it. given: (M, 2) the inputs.
    """
    rows = len(error)
    p, v, u = error[..., 0], error[..., 1], given
    first, second = np.zeros((rows, AXES, PAIRS)), np.zeros((rows, AXES, STATES))
    first[..., :6] = np.stack([p * p, v * v, u * u, p * v, p * u, v * u], axis=-1)
    p_, v_ = then[..., 0], then[..., 1]
    second[..., :3] = np.stack([p_ * p_, v_ * v_, p_ * v_], axis=-1)
    one = np.ones(rows)
    for axis in range(AXES):
        at, its = 6 + 4 * axis, 3 + 3 * axis
        first[:, axis, at : at + 4] = np.stack([p[:, axis], v[:, axis], u[:, axis], one], axis=-1)
        second[:, axis, its : its + 3] = np.stack([p_[:, axis], v_[:, axis], one], axis=-1)
    columns = first[..., None]
    squares, steps = columns * first[..., None, :], columns * second[..., None, :]
    return squares[:, 0] + squares[:, 1], steps[:, 0] + steps[:, 1]


def following(gains: Floats) -> Floats:
    """L, `(M, 14, 9)`: the features of (e, u) are L ψ(e) where u is what the policies (M, 4) say."""
    k1, k2 = gains[:, 0], gains[:, 1]
    of = np.zeros((len(gains), PAIRS, STATES))
    p2, v2, pv = 0, 1, 2
    of[:, _P2, p2] = of[:, _V2, v2] = of[:, _PV, pv] = 1.0
    of[:, _U2, p2], of[:, _U2, v2], of[:, _U2, pv] = k1 * k1, k2 * k2, 2.0 * k1 * k2
    of[:, _PU, p2], of[:, _PU, pv] = -k1, -k2
    of[:, _VU, pv], of[:, _VU, v2] = -k1, -k2
    for axis in range(AXES):
        p, v, u, one = range(6 + 4 * axis, 10 + 4 * axis)
        p_, v_, one_ = range(3 + 3 * axis, 6 + 3 * axis)
        k3 = gains[:, 2 + axis]
        of[:, p, p_] = of[:, v, v_] = of[:, one, one_] = 1.0
        of[:, u, p_], of[:, u, v_], of[:, u, one_] = -k1, -k2, -k3
        of[:, _U2, p_], of[:, _U2, v_], of[:, _U2, one_] = 2.0 * k1 * k3, 2.0 * k2 * k3, k3 * k3
        of[:, _PU, p_] = of[:, _VU, v_] = -k3
    return of


def improve(gains: Floats, squares: Floats, steps: Floats, discount: float, factor: float, shift: float) -> Floats:
    """Better policies in view of all that was seen, `(M, 4)`: evaluate, take the best in view of that, and again.

    Args:
        gains: (M, 4) of the policies now. squares, steps: M1 and M2. discount: γ of a tick. factor: by which k1 and k2
            change at the most, either way. shift: by how much k3 changes at the most.
    """
    now = np.clip(gains, LOWEST, HIGHEST)
    low = np.maximum(LOWEST, np.concatenate([now[:, :2] / factor, now[:, 2:] - shift], axis=1))
    high = np.minimum(HIGHEST, np.concatenate([now[:, :2] * factor, now[:, 2:] + shift], axis=1))
    transition = solve(squares + RIDGE * np.eye(PAIRS), steps)  # from features to those of the next state
    unsettled = np.isfinite(transition).all(axis=(1, 2))
    for _ in range(ITERATIONS):
        if not unsettled.any():
            break
        better, sound = _best(now, transition, discount)
        better = np.clip(better, low, high)
        unsettled &= sound
        change = np.abs(better - now).max(axis=1)
        now = np.where(unsettled[:, None], better, now)
        unsettled &= change > SETTLED
    return now


def _best(gains: Floats, transition: Floats, discount: float) -> tuple[Floats, NDArray[np.bool_]]:
    """The policies that are best in view of the value of others, `(M, 4)`; and where there are such, `(M,)`.

    w = w_c + γ G Lᵀ w; with y = Lᵀ w of only 9 unknowns, (1 − γ Lᵀ G) y = Lᵀ w_c.
    """
    across = following(gains).transpose(0, 2, 1)
    system = np.eye(STATES) - discount * product(across, transition)
    begun = product(across, _COST[:, None])
    weights = _COST + discount * product(transition, solve(system, begun))[..., 0]
    with np.errstate(all="ignore"):
        curvature = weights[:, _U2 : _U2 + 1]
        slopes = weights[:, [_PU, _VU, 8, 12]]
        better = slopes / (2.0 * curvature)
    sound = np.isfinite(better).all(axis=1) & (curvature[:, 0] > LEAST_CURVATURE)
    return np.where(sound[:, None], better, gains), sound
