"""Flight along concurrent trajectories (Turpin, Michael and Kumar, Concurrent assignment and planning of trajectories
for large teams of robots, ICRA 2013): the controller `plan`, and the base classes of controllers that learn to do it.

All UAVs know all trajectories before take-off, depart together, stay in formation, and send nothing in flight. A UAV
flies straight from its start to its slot, r*(t) = r(0) + (g − r(0)) s(t). The slot is its place in the formation, which
is shrunk about the goal. UAVs with the same goal are companions and have one s(t), from rest to rest. The slot of a UAV
without companions is its goal. The offset of two companions is 1 − s times that of their starts plus s times that of
their slots. So UAVs of a formation that only shrinks never meet.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller, Memory, Received, Rows, Step, Which
from meanflock.agent.controllers.cruise import CRUISE_M_S, CruiseSpeed, against_the_air
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, States, Vectors

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
        starts, slots: (N, d) m, the ends of the trajectories. A UAV departs when it leaves the ground.
        at: a tick → states (N, 2d) and accelerations (N, d), m/s², in that tick.
    """

    def __init__(self, scenario: Scenario, plan: state.States, cruise_m_s: float = CRUISE_M_S) -> None:
        """`plan`: (N, 2d) the states at t = 0, known to all UAVs."""
        self._dt = scenario.dt
        self._launch_s: Floats = mission.launches(scenario).astype(np.float64) * scenario.dt
        self.starts = np.array(state.position(plan))
        goals = mission.goals(scenario)
        self.slots = slots(self.starts, goals, FILLED * scenario.destination.radius)
        way = self.slots - self.starts
        common = state.norm(way)
        for rows in companions(goals):
            common[rows] = math.fsum(common[rows]) / len(rows)
        self._profile = Trapezoid(common, cruise_m_s)
        self._way = way / np.where(common > 0.0, common, 1.0)[:, None]
        self.at = lru_cache(maxsize=2)(self._at)  # a controller asks several times for this tick and the one before

    def _at(self, tick: int) -> tuple[state.States, Floats]:
        """States (N, 2d) and accelerations (N, d), m/s², in a tick; read-only."""
        covered, speed, change = self._profile.at(tick * self._dt - self._launch_s)
        states = np.concatenate([self.starts + covered[:, None] * self._way, speed[:, None] * self._way], axis=-1)
        acceleration = change[:, None] * self._way
        states.flags.writeable = False
        acceleration.flags.writeable = False
        return states, acceleration

    def states(self, tick: int) -> state.States:
        """States (N, 2d) in a tick."""
        return self.at(tick)[0]


def slots(starts: Floats, goals: Floats, radius_m: float) -> Floats:
    """Slots, (N, d): the formation of the UAVs of each goal, shrunk until the outermost is `radius_m` from it."""
    ends = goals.copy()
    for rows in companions(goals):
        place = starts[rows] - starts[rows].mean(axis=0)
        outermost = state.norm(place).max()
        if outermost > 0.0:
            ends[rows] += place * min(1.0, radius_m / outermost)
    return ends


def companions(goals: Floats) -> list[NDArray[np.intp]]:
    """Indices of the rows of `goals`, (N, d), grouped by goal."""
    _, group = np.unique(goals, axis=0, return_inverse=True)
    return [np.flatnonzero(group == number) for number in range(int(group.max(initial=-1)) + 1)]


class AlongPlan:
    """Prediction of a return to a plan: s*(t) + (s − s*)·e^(−age/τ), with s − s* at the time of sending."""

    def __init__(self, plan: Callable[[int], States], dt: float, tau_s: float = 2.0) -> None:
        """`plan`: the states s* of all UAVs in a tick, (N, 2d). `tau_s`: τ, in which a deviation falls to 1/e."""
        self._plan = plan
        # By age in ticks. A table, because the bits of an array `exp` depend on the position in the array.
        self._left = np.array([math.exp(-age * dt / tau_s) for age in range(math.ceil(40.0 * tau_s / dt) + 1)])

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        """See `Prediction`: the deviation from the plan."""
        return states - self._plan(tick)[uavs]

    def now(self, remembered: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        states = remembered * self._left[np.minimum(age, len(self._left) - 1)][:, None]
        states += np.swapaxes(self._plan(tick)[uavs], -1, -2)
        return states


class Planned(Controller):
    """Base class of controllers that follow trajectories known to all; their option `speed_m_s` is the cruise speed."""

    broadcast_numbers = 0

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return {"uav": uavs.astype(np.int32)}

    @cached_property
    def _trajectory(self) -> Trajectory:
        return Trajectory(self.scenario, mission.starts(self.scenario), self.options.speed_m_s)

    def prediction(self) -> AlongPlan:
        """A UAV that is off its trajectory is predicted to return to it."""
        return AlongPlan(self._trajectory.states, self.scenario.dt)

    def _off(self, uavs: Rows, tick: int, own: States) -> tuple[Floats, Vectors]:
        """Errors of rows (M, 2d) to their trajectories, (M, d, 2) m and m/s; and accelerations there, (M, d)."""
        states, acceleration = (ideal[uavs] for ideal in self._trajectory.at(tick))
        off = own - states
        return np.stack([state.position(off), state.velocity(off)], axis=-1), acceleration


class PlannedLearner(Planned):
    """Base class of controllers that learn to follow trajectories.

    The model is an array of the memory, (M, weights), which the federation averages if the option `share` says so. The
    memory also has the last `tick`.
    """

    learned: ClassVar[str]  # name of the array that is the model

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters = (self.weights or 0) if options.share else 0
        self._launches = mission.launches(scenario)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return super().init(uavs, plan) | {"tick": np.full(len(uavs), -2, dtype=np.int32)}

    def get(self, memory: Memory) -> Floats:
        return memory[self.learned][:, : self.parameters]

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        learned = memory[self.learned].copy()
        learned[rows] = models
        return memory | {self.learned: learned}

    def report(self, memory: Memory) -> Floats:
        return memory[self.learned]

    def _follows(self, memory: Memory, tick: int) -> Mask:
        """Mask (M,) of the rows that flew in the tick before this one: neither paused nor on the ground."""
        follows: Mask = (memory["tick"] == tick - 1) & (tick > self._launches[memory["uav"]])
        return follows


class PlanFollower(Planned):
    """Follows a trajectory computed before take-off; every UAV knows the trajectories of all.

    a = a* + k_p (r* − r) + k_v (v* − v) + c0 (v − v_o). It sends nothing.
    """

    name = "plan"
    dimensions = (2, 3)

    class Options(base.Options, frozen=True):
        """The options of `plan`."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        position_gain_1_s2: Annotated[float, Meta(gt=0, description="k_p, 1/s²")] = 4.0
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 4.0

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        options = self.options
        off, acceleration = self._off(memory["uav"], tick, own)
        acceleration = acceleration - options.position_gain_1_s2 * off[..., 0] - options.velocity_gain_1_s * off[..., 1]
        return Step(memory, acceleration + against_the_air(self.scenario, own))


def tracking(error: Floats) -> Floats:
    """Cost ‖p‖² + ½‖v‖² of errors (M, 2 axes, 2) to the trajectory, `(M,)`."""
    each = error[..., 0] ** 2 + 0.5 * error[..., 1] ** 2
    total: Floats = each[..., 0] + each[..., 1]
    return total
