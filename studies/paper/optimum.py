"""The best possible flight of one UAV, and how much dearer the flown ones are.

Alone, in the mean wind and without noise, a UAV minimises ∫ φ_L + c3‖a‖² dt over a given time. The first term of φ_L,
v·r/‖r‖, is d‖r‖/dt, so its integral is ‖r(T)‖ − ‖r(0)‖ on any path: what is left is a distance plus a quadratic form of
the accelerations. That is convex, so the optimum found is the global one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.point_mass import PointMass

Floats = NDArray[np.float64]

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
    position, velocity = states[-1][..., state.POSITION], states[1:][..., state.VELOCITY]
    running = cost.c1 * (velocity**2).sum(axis=(0, -1)) + cost.c3 * (accelerations**2).sum(axis=(0, -1))
    return np.sqrt((position**2).sum(axis=-1)) + dt * running


def response(scenario: Scenario, ticks: int, knots: int) -> tuple[Floats, Floats, Floats]:
    """How acceleration, velocity and position of one axis answer to the knots: (K, M), (K + 1, M), (K + 1, M).

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
    states = np.empty((ticks + 1, state.SIZE))
    states[0] = start
    nothing, vehicle = np.zeros(state.AXES), PointMass(PointMass.Options(), scenario)
    for n in range(ticks):
        states[n + 1], _ = vehicle.step(states[n], {}, nothing, nothing)
    return states


def best_flight(scenario: Scenario, start: Floats, ticks: int) -> Optimum:
    """The cheapest flight of `ticks` ticks from `start` (4,), by direct transcription; exact for its knots.

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
        """The flight u stands for."""
        by_acceleration, by_velocity, by_position = self._by_unknowns
        states = self._drift.copy()
        states[:, state.VELOCITY] += by_velocity @ unknowns
        states[:, state.POSITION] += by_position @ unknowns
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
    moving = drift[1:, state.VELOCITY]
    return Transcription(
        scenario=scenario,
        linear=2.0 * dt * cost.c1 * (by_unknowns[1][1:].T @ moving),
        end=by_unknowns[2][-1],
        coast=drift[-1, state.POSITION],
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
        last = states[ticks, uav, state.POSITION]
        left = float(np.linalg.norm(last)) if moving else 0.0
        result[uav] = (float(realised) - left) / best_flight(scenario, states[0, uav], ticks).cost
    return result
