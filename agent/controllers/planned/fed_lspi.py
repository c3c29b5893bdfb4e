"""Federated least-squares policy iteration: learns in flight to follow the plan, without a model of drag and wind.

Every UAV knows its trajectory (`trajectory.py`), but not its dynamics. It perturbs its commands at first, records how
the error changes, and every two seconds improves its four gains by least-squares policy iteration (Lagoudakis and Parr
2003). The federation averages the gains, because one UAV's data are few and noisy, and the errors of 25 UAVs are
nearly independent.

An axis has the error e = (p, v), m and m/s, to the trajectory and the input u, m/s², on top of its acceleration. The
policy is u = −k1 p − k2 v − k3, with k1 and k2 of both axes and a k3 for each; the cost of a tick is p² + ½v² + ½u².
The discounted cost from (e, u) on is a quadratic function w·φ of 14 features. Two matrices sum all data, whatever the
policy was: M1 = Σ φφᵀ and M2 = Σ φ ψ(e′)ᵀ. ψ are the 9 features of a state. They give the features of the next (e′, u′)
for any policy, φ′ = L ψ(e′).
"""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Memory, Received, Rows, Step
from meanflock.agent.controllers.cruise import CRUISE_M_S, CruiseSpeed
from meanflock.agent.controllers.elimination import product, solve
from meanflock.agent.controllers.planned.plan import PlannedLearner, tracking
from meanflock.swarm import seeds, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

GAINS = 4  # k1 1/s², k2 1/s, k3 along x and y m/s²
PAIRS, STATES = 14, 9  # features of (e, u) and of e
RIDGE = 1e-7
ITERATIONS = 15
SETTLED = 1e-6  # the iteration ends when the gains change by less
LEAST_CURVATURE = 1e-6  # of the value along u; with less curvature there is no minimum
LOWEST, HIGHEST = np.array([0.02, 0.1, -3.0, -3.0]), np.array([10.0, 10.0, 3.0, 3.0])  # bounds of the gains in flight

_P2, _V2, _U2, _PV, _PU, _VU = range(6)  # sums over both axes; the other features are p, v, u and 1 of each axis
_UPPER = np.triu_indices(PAIRS)  # M1 is symmetric, so only this half is sent
_COST = np.zeros(PAIRS)
_COST[[_P2, _V2, _U2]] = 1.0, 0.5, 0.5


class FedLspi(PlannedLearner):
    """Follows the trajectory of `plan` with gains that it learns by least-squares policy iteration.

    The federation averages the gains. With `share = "data"` it averages the sums of what the UAVs measured, 231 floats,
    and with `share = false` every UAV learns alone.
    """

    name = "fed-lspi"
    learned = "gains"
    weights = GAINS
    diagnostics = ("tracking_cost", "k1", "k2", "k3_x", "k3_y")
    period_ticks = 20

    class Options(base.Options, frozen=True):
        """The options of `fed-lspi`."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        share: Annotated[
            bool | Literal["gains", "data"],
            Meta(
                description="what the federation averages: the `gains` (or `true`), the `data` they are learned from, "
                "or `false`: nothing"
            ),
        ] = True
        discount: Annotated[float, Meta(gt=0, lt=1, description="γ, discount of the cost per tick, 1")] = 0.95
        k1: Annotated[float, Meta(ge=0.02, le=10, description="initial gain of the position error, 1/s²")] = 0.3
        k2: Annotated[float, Meta(ge=0.1, le=10, description="initial gain of the velocity error, 1/s")] = 1.0
        exploration: Annotated[float, Meta(ge=0, le=3, description="std of the perturbation an axis, m/s²")] = 0.3
        exploration_time: Annotated[float, Meta(ge=0, description="duration of the perturbation, s")] = 30.0
        period: Annotated[float, Meta(gt=0, description="time between two improvements, if not federated, s")] = 2.0
        gain_factor: Annotated[
            float, Meta(gt=1, description="largest factor by which an improvement changes k1 or k2, 1")
        ] = 2.0
        offset_change: Annotated[float, Meta(gt=0, description="largest change of k3 by an improvement, m/s²")] = 0.6
        limit: Annotated[float, Meta(gt=0, description="limit of the input an axis, m/s²")] = 3.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._shares_data = options.share == "data"
        if self._shares_data:
            self.parts = len(_UPPER[0]), PAIRS * STATES
            self.parameters = sum(self.parts)
        self.period_ticks = max(1, round(options.period / scenario.dt))
        self._exploration_ticks = round(options.exploration_time / scenario.dt)
        self._noise: dict[int, Floats] = {}

    def init(self, uavs: NDArray[np.intp], plan: state.States) -> Memory:
        rows, first = len(uavs), [self.options.k1, self.options.k2, 0.0, 0.0]
        return super().init(uavs, plan) | {
            "gains": np.tile(np.array(first), (rows, 1)),
            "squares": np.zeros((rows, PAIRS, PAIRS)),
            "steps": np.zeros((rows, PAIRS, STATES)),
            "error": np.zeros((rows, state.axes(plan), 2)),  # and input, of `tick`
            "input": np.zeros((rows, state.axes(plan))),
        }

    def step(self, memory: Memory, tick: int, own: state.States, received: Sequence[Received]) -> Step:
        uavs = memory["uav"]
        error, acceleration = self._off(uavs, tick, own)
        memory = self._learn(memory, tick, error)
        gains = memory["gains"]
        wanted = inputs(gains, error)
        if tick < self._exploration_ticks:
            wanted = wanted + self.options.exploration * self._perturbation(uavs, tick)
        given = np.clip(wanted, -self.options.limit, self.options.limit)
        after = memory | {"error": error, "input": given, "tick": np.full(len(own), tick, dtype=np.int32)}
        reported = np.concatenate([tracking(error)[:, None], gains], axis=1)
        return Step(after, acceleration + given, reported)

    def get(self, memory: Memory) -> Floats:
        if not self._shares_data:
            return super().get(memory)
        steps = memory["steps"]
        return np.concatenate([memory["squares"][:, *_UPPER], steps.reshape(len(steps), -1)], axis=1)

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        if not self._shares_data:
            return super().set(memory, rows, models)
        upper, flat = np.split(models, self.parts[:1], axis=1)
        squares, steps = memory["squares"].copy(), memory["steps"].copy()
        square = np.zeros((len(rows), PAIRS, PAIRS))
        square[:, *_UPPER] = upper
        square[:, *_UPPER[::-1]] = upper
        squares[rows], steps[rows] = square, flat.reshape(-1, PAIRS, STATES)
        return memory | {"squares": squares, "steps": steps}

    def _learn(self, memory: Memory, tick: int, error: Floats) -> Memory:
        """The memory with the data of the last tick, and with improved gains in the tick before a round."""
        squares, steps = memory["squares"], memory["steps"]
        fresh = self._follows(memory, tick)
        if fresh.any():
            first, second = seen(memory["error"], memory["input"], error)
            first[~fresh] = second[~fresh] = 0.0
            squares = squares + first
            steps = steps + second
        memory = memory | {"squares": squares, "steps": steps}
        if (tick + 1) % self.period_ticks == 0:
            options = self.options
            better = improve(
                memory["gains"], squares, steps, options.discount, options.gain_factor, options.offset_change
            )
            memory = memory | {"gains": better}
        return memory

    def _perturbation(self, uavs: NDArray[np.int32], tick: int) -> Floats:
        """Standard normal numbers, (M, 2), of the UAVs in a tick."""
        return np.array([self._numbers(int(uav))[tick] for uav in uavs]).reshape(-1, self.scenario.dimensions)

    def _numbers(self, uav: int) -> Floats:
        """The perturbations of a UAV in all ticks, (ticks, 2)."""
        if uav not in self._noise:
            draw = seeds.generator(self.scenario.seed, "controller", uav)
            self._noise[uav] = draw.standard_normal((self._exploration_ticks, self.scenario.dimensions))
        return self._noise[uav]


def inputs(gains: Floats, error: Floats) -> Floats:
    """Inputs u of the policies (M, 4) at errors (M, 2 axes, 2), `(M, 2)` m/s². Gains are clipped to their bounds."""
    k = np.clip(gains, LOWEST, HIGHEST)
    return -k[:, :1] * error[..., 0] - k[:, 1:2] * error[..., 1] - k[:, 2:]


def seen(error: Floats, given: Floats, then: Floats) -> tuple[Floats, Floats]:
    """Terms of a tick in M1 and M2, `(M, 14, 14)` and `(M, 14, 9)`.

    Args:
        error, then: (M, 2 axes, 2) the errors before and after it. given: (M, 2) the inputs.
    """
    rows, axes = error.shape[:2]
    p = error[..., 0]
    v = error[..., 1]
    u = given
    first, second = np.zeros((rows, axes, PAIRS)), np.zeros((rows, axes, STATES))
    first[..., :6] = np.stack([p * p, v * v, u * u, p * v, p * u, v * u], axis=-1)
    p_, v_ = then[..., 0], then[..., 1]
    second[..., :3] = np.stack([p_ * p_, v_ * v_, p_ * v_], axis=-1)
    one = np.ones(rows)
    for axis in range(axes):
        at, its = 6 + 4 * axis, 3 + 3 * axis
        first[:, axis, at : at + 4] = np.stack([p[:, axis], v[:, axis], u[:, axis], one], axis=-1)
        second[:, axis, its : its + 3] = np.stack([p_[:, axis], v_[:, axis], one], axis=-1)
    squares, steps = np.zeros((rows, PAIRS, PAIRS)), np.zeros((rows, PAIRS, STATES))
    for axis in range(axes):
        column = first[:, axis, :, None]
        squares += column * first[:, axis, None, :]
        steps += column * second[:, axis, None, :]
    return squares, steps


def following(gains: Floats) -> Floats:
    """Matrix L, `(M, 14, 9)`, with φ(e, u) = L ψ(e) if u is the input of the policies (M, 4)."""
    k1, k2 = gains[:, 0], gains[:, 1]
    matrix = np.zeros((len(gains), PAIRS, STATES))
    p2 = 0
    v2 = 1
    pv = 2
    matrix[:, _P2, p2] = matrix[:, _V2, v2] = matrix[:, _PV, pv] = 1.0
    matrix[:, _U2, p2] = k1 * k1
    matrix[:, _U2, v2] = k2 * k2
    matrix[:, _U2, pv] = 2.0 * k1 * k2
    matrix[:, _PU, p2], matrix[:, _PU, pv] = -k1, -k2
    matrix[:, _VU, pv], matrix[:, _VU, v2] = -k1, -k2
    for axis in range(gains.shape[1] - 2):
        p, v, u, one = range(6 + 4 * axis, 10 + 4 * axis)
        p_, v_, one_ = range(3 + 3 * axis, 6 + 3 * axis)
        k3 = gains[:, 2 + axis]
        matrix[:, p, p_] = matrix[:, v, v_] = matrix[:, one, one_] = 1.0
        matrix[:, u, p_] = -k1
        matrix[:, u, v_] = -k2
        matrix[:, u, one_] = -k3
        matrix[:, _U2, p_] = 2.0 * k1 * k3
        matrix[:, _U2, v_] = 2.0 * k2 * k3
        matrix[:, _U2, one_] = k3 * k3
        matrix[:, _PU, p_] = matrix[:, _VU, v_] = -k3
    return matrix


def improve(gains: Floats, squares: Floats, steps: Floats, discount: float, factor: float, shift: float) -> Floats:
    """Improved policies, `(M, 4)`, by policy iteration on all data: evaluate, choose the best policy, repeat.

    Args:
        gains: (M, 4) of the policies now. squares, steps: M1 and M2. discount: γ of a tick. factor: largest
            factor of a change of k1 and k2. shift: largest change of k3.
    """
    now = np.clip(gains, LOWEST, HIGHEST)
    low = np.maximum(LOWEST, np.concatenate([now[:, :2] / factor, now[:, 2:] - shift], axis=1))
    high = np.minimum(HIGHEST, np.concatenate([now[:, :2] * factor, now[:, 2:] + shift], axis=1))
    transition = solve(squares + RIDGE * np.eye(PAIRS), steps)  # from features to those of the next state
    unsettled = np.isfinite(transition).all(axis=(1, 2))
    for _ in range(ITERATIONS):
        if not unsettled.any():
            break
        better, valid = _best(now, transition, discount)
        better = np.clip(better, low, high)
        unsettled &= valid
        change = np.abs(better - now).max(axis=1)
        now = np.where(unsettled[:, None], better, now)
        unsettled &= change > SETTLED
    return now


def _best(gains: Floats, transition: Floats, discount: float) -> tuple[Floats, NDArray[np.bool_]]:
    """The best policies for the values of the given policies, `(M, 4)`, and a mask (M,) of the rows that have one.

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
    valid = np.isfinite(better).all(axis=1) & (curvature[:, 0] > LEAST_CURVATURE)
    return np.where(valid[:, None], better, gains), valid
