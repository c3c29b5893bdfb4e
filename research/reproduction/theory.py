"""The paper's theory, measured on the code that flies.

The density learner as an LMS filter (Prop. 3), boundedness (Props. 1 and 2, Cor. 1), and the optimal flight of one UAV.

Alone, in the mean wind and without noise, a UAV minimises ∫ φ_L + c3‖a‖² dt over a given time. The first term of φ_L,
v·r/‖r‖, is d‖r‖/dt, so its integral is ‖r(T)‖ − ‖r(0)‖ on any path: what is left is a distance plus a quadratic form of
the accelerations. That is convex, so the optimum found is the global one.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.mean_field.learner import tables
from meanflock.kernels.mean_field import features, fpk, hjb
from meanflock.kernels.mean_field.layout import DENSITY, VALUE
from meanflock.launch.engine import Engine
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.vehicles.point_mass import PointMass

Floats = NDArray[np.float64]

# A slot fails once in 1e11 times and a message has a hundred of them, everybody is in range, nothing is rounded.
_CLEAR = {"target_snr_db": 40.0, "latency_threshold_slots": 100, "range_m": 1e9, "bits_per_float": 64}


# -- the density learner as an LMS filter (Prop. 3) ------------------------------------------------------------------


def fpk_gradients(scenario: Scenario, states: Floats, actions: Floats, curvature: Floats) -> Floats:
    """g = ∇_{ŵF} e_F at `states`, `(S, 138)`: the regressor of the LMS recursion, by the learner's own basis.

    Args:
        states: (S, 4). actions: â, (S, 2), m/s². curvature: ψ̂_vxvx + ψ̂_vyvy, (S,).
    """
    t = tables(scenario)
    pairs = features.pairs(t, features.powers(t, states))
    b = np.concatenate([state.velocity(states), hjb.drift(t, states, actions)], axis=-1)
    operator = fpk.operator(t, pairs, b, fpk.divergence(t, curvature))
    return np.concatenate([operator, features.terms(t, pairs)[:, 1:]], axis=-1)


def correlation(gradients: Floats) -> Floats:
    """R = E[g gᵀ], Eq. R, `(M, M)`, of samples `(S, M)`."""
    return gradients.T @ gradients / len(gradients)


def step_bound(r: Floats) -> float:
    """2 / λ_max(R), Eq. step_cond: the mean of the weights converges for every μ_F below."""
    return 2.0 / float(np.linalg.eigvalsh(r)[-1])


def mean_square_deviation(r: Floats, start: Floats, mu: float, noise: float, steps: int) -> float:
    """E‖w̃(n)‖² of App. C, with Σ = I.

    In the eigenvectors of R the recursion E‖w̃‖²_Σ′ + μ²‖ε‖² tr(R_Σ) decouples:
    Σ_k (1−μλ_k)²ⁿ w̃_k(0)² + μ² σ² λ_k (1 − (1−μλ_k)²ⁿ) / (1 − (1−μλ_k)²). It leaves out the fourth moment of g, so
    it holds for small μ.

    Args:
        r: (M, M). start: w̃(0), (M,). mu: μ_F. noise: standard deviation of ε_F.
    """
    values, vectors = np.linalg.eigh(r)
    values = np.maximum(values, 0.0)
    decay = (1.0 - mu * values) ** 2
    left = decay**steps
    gain = np.divide(mu**2 * noise**2 * values, 1.0 - decay, out=np.zeros_like(values), where=decay < 1.0)
    return float((left * (vectors.T @ start) ** 2 + gain * (1.0 - left)).sum())


def simulate_lms(
    gradients: Floats, start: Floats, mu: float, noise: float, steps: int, repeats: int, seed: int
) -> Floats:
    """w̃(n) after `steps` steps of w̃ ← w̃ − μ g (gᵀw̃ + ε), Eq. Weight_err, `(repeats, M)`.

    Args:
        gradients: (S, M), drawn from at random. start: (M,). noise: standard deviation of ε.
    """
    draw = np.random.default_rng(seed)
    deviation = np.repeat(start[None], repeats, axis=0)
    for _ in range(steps):
        g = gradients[draw.integers(len(gradients), size=repeats)]
        error = state.dot(g, deviation) + noise * draw.standard_normal(repeats)
        deviation -= mu * error[:, None] * g
    return deviation


def learnable_directions(r: Floats, mu: float, steps: int) -> int:
    """Number of eigendirections of R in which the mean moves more than 1 − 1/e of the way in `steps` steps."""
    values = np.maximum(np.linalg.eigvalsh(r), 0.0)
    return int(np.count_nonzero((1.0 - mu * values) ** steps < np.exp(-1.0)))


# -- boundedness (Props. 1 and 2, Cor. 1) ----------------------------------------------------------------------------


@dataclass(frozen=True)
class LongFlight:
    """Norms along a long flight, each `(T,)`, the largest over the UAVs that are not lost.

    state: ‖s‖, m and m/s. value, density: ‖ŵ_H‖ and ‖ŵ_F‖. lost: UAVs whose learner or state left every bound.
    """

    state: Floats
    value: Floats
    density: Floats
    lost: int


def fly_long(scenario: Scenario, seconds: float) -> LongFlight:
    """Fly a scenario with the radio of `clear`: with hjb every UAV knows all states of the last tick."""
    engine = Engine(clear(scenario, seconds), "long")
    rows = [_norms(engine.world.flight, engine.models) for _ in engine.fly()]
    engine.finish()
    table = np.array(rows)
    return LongFlight(table[:, 0], table[:, 1], table[:, 2], int(table[-1, 3]))


def clear(scenario: Scenario, seconds: float) -> Scenario:
    """The scenario for `seconds`, with or without arrivals, and with a radio that neither loses nor rounds."""
    radio = msgspec.structs.replace(scenario.radio, **_CLEAR)
    return msgspec.structs.replace(scenario, duration=seconds, stop="duration", radio=radio)


def _norms(flight: Flight, models: Floats) -> tuple[float, float, float, int]:
    alive = flight.status != Status.LOST
    if not alive.any():
        return (np.inf, np.inf, np.inf, len(alive))

    def largest(part: Floats) -> float:
        return float(np.sqrt(state.dot(part, part)).max())

    furthest, known = float(state.norm(flight.states[alive]).max()), models[alive]
    return furthest, largest(known[:, VALUE]), largest(known[:, DENSITY]), int((~alive).sum())


def growth(norms: Floats) -> float:
    """Largest norm of the last third of a flight over the largest of the first two; ≤ 1 means no new record."""
    cut = 2 * len(norms) // 3
    return float(norms[cut:].max() / norms[:cut].max())


# -- best possible flight of one UAV -----------------------------------------------------------------------------------


_KNOTS = 120  # of the piecewise linear acceleration


@dataclass(frozen=True, slots=True)
class Optimum:
    """cost: see `flight_cost`, m. accelerations: (K, 2), m/s². states: (K + 1, 4)."""

    cost: float
    accelerations: Floats
    states: Floats


def flight_cost(scenario: Scenario, states: Floats, accelerations: Floats) -> Floats:
    """‖r(T)‖ + ∫ c1‖v‖² + c3‖a‖² dt, in metres: the paper's cost without φ_G plus the constant ‖r(0)‖.

    With that constant the cost is positive, and a ratio of two costs means something.

    Args:
        states: (K + 1, ..., 4), of ticks 0…K. accelerations: (K, ..., 2), of the ticks that led to 1…K. Returns: (...).
    """
    cost, dt = scenario.cost, scenario.dt
    position, velocity = state.position(states[-1]), state.velocity(states[1:])
    running = cost.c1 * (velocity**2).sum(axis=(0, -1)) + cost.c3 * (accelerations**2).sum(axis=(0, -1))
    return np.sqrt((position**2).sum(axis=-1)) + dt * running


def response(scenario: Scenario, ticks: int, knots: int) -> tuple[Floats, Floats, Floats]:
    """Response of acceleration, velocity and position of one axis to the knots: (K, M), (K + 1, M), (K + 1, M).

    The accelerations are linear between M knots spread evenly over the flight; row n is tick n.
    """
    at = np.linspace(0.0, knots - 1.0, ticks)
    left = np.minimum(at.astype(int), max(knots - 2, 0))
    acceleration = np.zeros((ticks, knots))
    acceleration[np.arange(ticks), left] = 1.0 - (at - left)
    if knots > 1:
        acceleration[np.arange(ticks), left + 1] = at - left
    velocity, position = np.zeros((ticks + 1, knots)), np.zeros((ticks + 1, knots))
    keep = 1.0 - scenario.wind.drag * scenario.dt
    for n in range(ticks):
        velocity[n + 1] = keep * velocity[n] + scenario.dt * acceleration[n]
        position[n + 1] = position[n] + scenario.dt * velocity[n + 1]
    return acceleration, velocity, position


def coast(scenario: Scenario, start: Floats, ticks: int) -> Floats:
    """The flight without command in the mean wind, `(ticks + 1, 4)`, by the world's own dynamics."""
    states = np.empty((ticks + 1, scenario.state_numbers))
    states[0] = start
    nothing, vehicle = np.zeros(scenario.dimensions), PointMass(PointMass.Options(), scenario)
    for n in range(ticks):
        states[n + 1], _ = vehicle.step(states[n], {}, nothing, nothing)
    return states


def best_flight(scenario: Scenario, start: Floats, ticks: int) -> Optimum:
    """The optimal flight of `ticks` ticks from `start` (4,), by direct transcription; exact for its knots.

    Scaled by the Cholesky factor of the quadratic form the problem is min ½‖u‖² + ℓ·u + ‖d + eᵀu‖ with u `(M, 2)`.
    Where it is least, u = −ℓ − e λᵀ with ‖λ‖ ≤ 1 the direction of r(T), or what brings r(T) to the origin.
    """
    problem = transcribe(scenario, start, ticks)
    reach = float(problem.end @ problem.end)
    ahead = problem.coast - problem.end @ problem.linear  # r(T) if distance were free
    direction = ahead / max(float(np.linalg.norm(ahead)), reach)
    return problem.flight(-problem.linear - np.outer(problem.end, direction))


@dataclass(frozen=True)
class Transcription:
    """The problem in scaled unknowns u (M, 2): cost = constant + ½‖u‖² + linear·u + ‖coast + endᵀu‖, in metres.

    linear: ℓ, (M, 2). end: e, (M,). coast: where the UAV would end without command, (2,), m.
    """

    scenario: Scenario
    linear: Floats
    end: Floats
    coast: Floats
    constant: float
    _drift: Floats
    _by_unknowns: tuple[Floats, Floats, Floats]

    def cost(self, unknowns: Floats) -> float:
        """The cost of u, m."""
        last = self.coast + self.end @ unknowns
        quadratic = 0.5 * float((unknowns**2).sum()) + float((self.linear * unknowns).sum())
        return self.constant + quadratic + float(np.linalg.norm(last))

    def flight(self, unknowns: Floats) -> Optimum:
        """The flight of u."""
        by_acceleration, by_velocity, by_position = self._by_unknowns
        states = self._drift.copy()
        state.velocity(states)[...] += by_velocity @ unknowns
        state.position(states)[...] += by_position @ unknowns
        accelerations = by_acceleration @ unknowns
        return Optimum(float(flight_cost(self.scenario, states, accelerations)), accelerations, states)


def transcribe(scenario: Scenario, start: Floats, ticks: int) -> Transcription:
    """The problem of `ticks` ticks from `start` (4,), the acceleration linear between at most 120 knots."""
    by_acceleration, by_velocity, by_position = response(scenario, ticks, min(ticks, _KNOTS))
    drift = coast(scenario, start, ticks)
    cost, dt = scenario.cost, scenario.dt
    hessian = 2.0 * dt * (cost.c1 * by_velocity.T @ by_velocity + cost.c3 * by_acceleration.T @ by_acceleration)
    scaled = np.linalg.inv(np.linalg.cholesky(hessian)).T  # knots = scaled @ u
    by_unknowns = (by_acceleration @ scaled, by_velocity @ scaled, by_position @ scaled)
    moving = state.velocity(drift)[1:]
    return Transcription(
        scenario=scenario,
        linear=2.0 * dt * cost.c1 * (by_unknowns[1][1:].T @ moving),
        end=by_unknowns[2][-1],
        coast=state.position(drift)[-1],
        constant=dt * cost.c1 * float((moving**2).sum()),
        _drift=drift,
        _by_unknowns=by_unknowns,
    )


def gaps(
    scenario: Scenario, states: Floats, accelerations: Floats, arrival: NDArray[np.intp], *, moving: bool = False
) -> Floats:
    """Realised over optimal cost of every UAV, each over its own time until arrival, or the whole flight, `(N,)`.

    Args:
        states: (K + 1, N, 4). accelerations: (K, N, 2). arrival: tick of arrival, −1 for none, (N,).
            moving: without the distance left at the end, which is arrived with and not flown for.
    """
    result = np.empty(states.shape[1])
    for uav, tick in enumerate(arrival.tolist()):
        ticks = tick if tick > 0 else len(accelerations)
        realised = flight_cost(scenario, states[: ticks + 1, uav], accelerations[:ticks, uav])
        last = state.position(states[ticks, uav])
        left = float(np.linalg.norm(last)) if moving else 0.0
        result[uav] = (float(realised) - left) / best_flight(scenario, states[0, uav], ticks).cost
    return result
