"""Concurrent trajectories of all UAVs, which depart together and stay in formation.

Each UAV flies straight from its start to a slot near the destination, r*(t) = r(0) + (g − r(0)) s(t). All UAVs with the
same goal have one s(t), from rest to rest. The offset of two of them is 1 − s times that of their starts plus s times
that of their slots. So UAVs of a formation that only shrinks never meet.
"""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.cruise import CRUISE_M_S
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

ACCELERATION_M_S2, BRAKE_M_S2 = 1.0, 0.5
FILLED = 0.84  # largest distance of a slot from the goal, relative to the destination's radius


class Trapezoid:
    """Speed profile from rest to rest: full acceleration, cruise, braking. On short ways it does not reach cruise."""

    def __init__(
        self,
        length_m: Floats,
        cruise_m_s: float = CRUISE_M_S,
        acceleration_m_s2: float = ACCELERATION_M_S2,
        brake_m_s2: float = BRAKE_M_S2,
    ) -> None:
        """`length_m`: of ways, any shape, zero included."""
        self._up, self._down = acceleration_m_s2, brake_m_s2
        inverse = 1.0 / acceleration_m_s2 + 1.0 / brake_m_s2
        self._peak = np.minimum(cruise_m_s, np.sqrt(2.0 * length_m / inverse))
        self._speeding_s, self._braking_s = self._peak / acceleration_m_s2, self._peak / brake_m_s2
        moving = np.where(self._peak > 0.0, self._peak, 1.0)
        self._cruising_s = (length_m - 0.5 * self._peak * (self._speeding_s + self._braking_s)) / moving
        self._length = length_m
        self.duration_s = self._speeding_s + self._cruising_s + self._braking_s

    def at(self, seconds: Floats | float) -> tuple[Floats, Floats, Floats]:
        """Distance m, speed m/s and acceleration m/s² at a time since departure; at rest before and after."""
        t = np.clip(seconds, 0.0, self.duration_s)
        left = self.duration_s - t
        speeding, braking = t < self._speeding_s, left < self._braking_s
        covered = np.where(
            speeding,
            0.5 * self._up * t * t,
            np.where(
                braking,
                self._length - 0.5 * self._down * left * left,
                self._peak * (t - 0.5 * self._speeding_s),
            ),
        )
        speed = np.where(speeding, self._up * t, np.where(braking, self._down * left, self._peak))
        change = np.where(speeding, self._up, np.where(braking, -self._down, 0.0))
        resting = (np.asarray(seconds) < 0.0) | (seconds >= self.duration_s)
        return covered, np.where(resting, 0.0, speed), np.where(resting, 0.0, change)


class Trajectory:
    """The trajectories of all UAVs of a scenario.

    Attributes:
        starts, slots: (N, 2) m, the ends of the trajectories. A UAV departs when it leaves the ground.
    """

    def __init__(self, scenario: Scenario, plan: state.States, cruise_m_s: float = CRUISE_M_S) -> None:
        """`plan`: (N, 4) the states at t = 0, known to all UAVs."""
        self._dt = scenario.dt
        self._launch_s: Floats = mission.launches(scenario).astype(np.float64) * scenario.dt
        self.starts = np.array(plan[:, state.POSITION])
        goals = mission.goals(scenario)
        self.slots = slots(self.starts, goals, FILLED * scenario.destination.radius)
        way = self.slots - self.starts
        common = state.norm(way)
        for rows in companions(goals):
            common[rows] = math.fsum(common[rows]) / len(rows)
        self._profile = Trapezoid(common, cruise_m_s)
        self._way = way / np.where(common > 0.0, common, 1.0)[:, None]

    def at(self, tick: int) -> tuple[Floats, Floats, Floats]:
        """Positions, velocities and accelerations (N, 2) in a tick, m, m/s and m/s²."""
        covered, speed, change = self._profile.at(tick * self._dt - self._launch_s)
        return (
            self.starts + covered[:, None] * self._way,
            speed[:, None] * self._way,
            change[:, None] * self._way,
        )

    def states(self, tick: int) -> state.States:
        """States (N, 4) in a tick."""
        position, velocity, _ = self.at(tick)
        return np.concatenate([position, velocity], axis=-1)


def slots(starts: Floats, goals: Floats, radius_m: float) -> Floats:
    """Slots, (N, 2): the formation of the UAVs of each goal, shrunk until the outermost is `radius_m` from it."""
    ends = goals.copy()
    for rows in companions(goals):
        place = starts[rows] - starts[rows].mean(axis=0)
        outermost = state.norm(place).max()
        if outermost > 0.0:
            ends[rows] += place * min(1.0, radius_m / outermost)
    return ends


def companions(goals: Floats) -> list[NDArray[np.intp]]:
    """Indices of the rows of `goals`, (N, 2), grouped by goal."""
    _, group = np.unique(goals, axis=0, return_inverse=True)
    return [np.flatnonzero(group == number) for number in range(int(group.max(initial=-1)) + 1)]
