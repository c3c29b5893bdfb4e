"""Flocking by Algorithm 3 of Olfati-Saber (Flocking for multi-agent dynamic systems: algorithms and theory, IEEE
Transactions on Automatic Control 51(3), 2006): gradient to a lattice, consensus on velocity, virtual agents on the
edges of obstacles, and attraction to the goal."""

import math
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Memory, Step
from meanflock.agent.controllers.cruise import acceleration_limit, limited
from meanflock.agent.controllers.goals import Goals
from meanflock.agent.controllers.sharing.base import SharingController
from meanflock.agent.controllers.sharing.nearby import Near, edges, near, summed
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Rows, States, Vectors


def bump(z: Rows, h: float) -> Rows:
    """Bump function ρ_h(z), his Eq. 10: 1 up to h, then smoothly down to 0 at 1."""
    falling = 0.5 * (1.0 + np.cos(math.pi * (z - h) / (1.0 - h)))
    return np.where(z < h, 1.0, np.where(z <= 1.0, falling, 0.0))


class OlfatiSaber(SharingController):
    """Flocking in a lattice, after Olfati-Saber (2006).

    u = gradient + consensus + saturated way to the goal, + c0 (v − v_o).
    """

    name = "olfati-saber"
    guided = True
    dimensions = (2, 3)

    class Options(base.Options, frozen=True):
        """The options of `olfati-saber`, by their names in the source where it has them."""

        d_m: Annotated[float, Meta(gt=0, description="d, distance in the lattice, m")] = 1.3
        r_m: Annotated[float, Meta(gt=0, description="r, range of neighbours, m")] = 1.56
        epsilon_1_m2: Annotated[float, Meta(gt=0, description="ε of the σ-norm, 1/m²")] = 0.1
        h: Annotated[float, Meta(ge=0, lt=1, description="h of the bump function")] = 0.2
        a: Annotated[float, Meta(gt=0, description="a of the action function, at most b, m/s²")] = 8.0
        b: Annotated[float, Meta(gt=0, description="b of the action function, m/s²")] = 8.0
        c1: Annotated[float, Meta(ge=0, description="weight of the gradient")] = 1.0
        c2_1_s: Annotated[float, Meta(ge=0, description="weight of the consensus, 1/s")] = 3.0
        d_obstacle_m: Annotated[float, Meta(gt=0, description="d', range of the repulsion by obstacles, m")] = 1.5
        c1_obstacle_m_s2: Annotated[float, Meta(ge=0, description="weight of the gradient of obstacles, m/s²")] = 3.0
        c2_obstacle_1_s: Annotated[float, Meta(ge=0, description="weight of the consensus with obstacles, 1/s")] = 0.5
        pull_m_s2: Annotated[float, Meta(gt=0, description="attraction to a distant goal, m/s²")] = 0.7
        near_m: Annotated[float, Meta(gt=0, description="distance within which the attraction is linear, m")] = 2.0
        damping_1_s: Annotated[float, Meta(gt=0, description="damping of the own velocity, 1/s")] = 0.4
        acceleration_max_m_s2: Annotated[
            float, Meta(gt=0, description="limit on ‖u‖ before drag, at most that of the vehicle, m/s²")
        ] = 6.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        if options.a > options.b:
            raise ValueError(f"`a` {options.a} is greater than `b` {options.b}; the action function needs 0 < a ≤ b")
        super().__init__(options, scenario)
        self._limit = acceleration_limit(scenario, options.acceleration_max_m_s2)
        self._goals = Goals(scenario)
        self._range, self._distance = self._sigma(options.r_m**2), self._sigma(options.d_m**2)
        self._shift = abs(options.a - options.b) / math.sqrt(4.0 * options.a * options.b)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return super().init(uavs, plan) | self._goals.init(uavs)

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        return self._goals.guide(memory, rows, goals)

    def fly(self, memory: Memory, own: States, others: States) -> Step:
        uavs, options = memory["neighbour_uav"], self.options
        pairs = near(own, others, uavs, options.r_m)
        way = (self._goals.of(memory, uavs) - state.position(own)) / options.near_m
        way /= np.sqrt(1.0 + state.dot(way, way))[:, None]
        acceleration = options.pull_m_s2 * way - options.damping_1_s * state.velocity(own)
        acceleration += summed(pairs.row, self._of_pairs(pairs), len(own))
        if len(self._obstacles):
            acceleration += self._of_obstacles(own)
        return Step(memory, limited(acceleration, self._limit))

    def _of_pairs(self, pairs: Near) -> Vectors:
        """Accelerations by pairs, c1 φ_α(‖Δ‖σ) n + c2 ρ_h (Δv), his Eq. 23, (P, d) m/s²."""
        options = self.options
        squared = pairs.distance * pairs.distance
        sigma = self._sigma(squared)
        weight = bump(sigma / self._range, options.h)
        z = sigma - self._distance + self._shift
        action = weight * 0.5 * ((options.a + options.b) * z / np.sqrt(1.0 + z * z) + (options.a - options.b))
        # n = Δ/√(1 + ε‖Δ‖²), his Eq. 9; 0 for two UAVs at one place
        along = (options.c1 * action / np.sqrt(1.0 + options.epsilon_1_m2 * squared))[:, None] * pairs.apart
        return -along - (options.c2_1_s * weight)[:, None] * pairs.closing

    def _of_obstacles(self, own: States) -> Vectors:
        """Acceleration by virtual agents on the edges of obstacles, his Eq. 56 to 59, (M, d) m/s²."""
        options = self.options
        edge, away, closing = edges(own, self._obstacles)
        gap = np.maximum(edge, 0.0)
        sigma, reach = self._sigma(gap * gap), self._sigma(options.d_obstacle_m**2)
        weight, z = bump(sigma / reach, options.h), sigma - reach
        action = options.c1_obstacle_m_s2 * weight * (1.0 - z / np.sqrt(1.0 + z * z))
        # The virtual agent has the UAV's velocity along the edge, times μ = R/(R + gap).
        slower = _along_edge(closing, away, self._obstacles.radii / (self._obstacles.radii + gap))
        damping = options.c2_obstacle_1_s * weight
        pushes = [action * n + damping * (agent - v) for n, agent, v in zip(away, slower, closing, strict=True)]
        return np.stack([np.add.reduce(push, axis=1) for push in pushes], axis=-1)

    def _sigma(self, squared: Any) -> Any:
        """σ-norm (√(1 + ε‖z‖²) − 1)/ε of ‖z‖², his Eq. 8."""
        epsilon = self.options.epsilon_1_m2
        return (np.sqrt(1.0 + epsilon * squared) - 1.0) / epsilon


def _along_edge(velocity: list[Rows], away: list[Rows], share: Rows) -> list[Rows]:
    """A share (M, K) of the parts of velocities at right angles to unit vectors n, n × (share · (v × n)), (M, K) along
    each axis."""
    if len(away) == state.PLANE:
        (vx, vy), (x, y) = velocity, away
        turn = share * (vy * x - vx * y)
        return [-y * turn, x * turn]
    turns = [share * turn for turn in _cross(velocity, away)]
    return _cross(away, turns)


def _cross(first: list[Rows], second: list[Rows]) -> list[Rows]:
    (a, b, c), (x, y, z) = first, second
    return [b * z - c * y, c * x - a * z, a * y - b * x]
