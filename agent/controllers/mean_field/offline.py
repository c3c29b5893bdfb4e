"""The offline method: every UAV flies an open-loop plan that was computed before take-off.

The plan is time-optimal for σ_wind = 0: a straight line to the goal at rest, as fast as the limits on speed and
acceleration over ground allow (bang, coast, bang). The commands also cancel the drag and the mean wind, which are
known beforehand. Without randomness the discrete motion follows the plan exactly. With it, errors of velocity and
position accumulate, and nothing corrects them.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats


def speeds(distance_m: float, speed_max: float, acceleration_max: float, dt: float) -> Floats:
    """The fastest profile from rest to rest over a distance, `(n,)` m/s: speed during tick 1…n, the last one 0.

    In n ticks a craft covers at most Σ min(k, n − k, v_max/(a_max dt)) a_max dt²; n is the fewest that reach
    `distance_m`, and the profile is scaled down to end there exactly, so both limits hold.
    """
    if distance_m == 0:
        return np.zeros(0)
    step = acceleration_max * dt
    enough = 2 * (math.ceil(speed_max / step) + 1) + math.ceil(distance_m / (speed_max * dt))

    def fastest(ticks: int) -> Floats:
        k = np.arange(1, ticks + 1)
        return np.minimum(np.minimum(k, ticks - k) * step, speed_max)

    fewest, most = 1, enough  # reach grows with the number of ticks: bisect
    while fewest < most:
        middle = (fewest + most) // 2
        if fastest(middle).sum() * dt < distance_m:
            fewest = middle + 1
        else:
            most = middle
    profile = fastest(fewest)
    return profile * (distance_m / (profile.sum() * dt))


class OpenLoopPlan:
    """The commands of M UAVs, tick by tick."""

    def __init__(self, scenario: Scenario, starts: Floats) -> None:
        """`starts`: their states in the mission plan relative to their goals, `(M, 2d)`."""
        limits = scenario.offline
        wind = scenario.wind
        dt = scenario.dt
        distance = np.sqrt((state.position(starts) * state.position(starts)).sum(axis=-1))
        flown = scenario.max_ticks  # a longer plan is cut off
        profiles = [speeds(float(d), limits.speed_max, limits.acceleration_max, dt)[:flown] for d in distance]
        along = np.zeros((1 + max(map(len, profiles), default=0), len(starts)))
        for uav, profile in enumerate(profiles):
            along[1 : 1 + len(profile), uav] = profile
        heading = -state.position(starts) / np.where(distance > 0, distance, 1.0)[:, None]
        velocity = along[..., None] * heading  # before tick k + 1, over ground
        cancel = wind.drag * (velocity - scenario.space.vector(wind.mean))
        self._commands = cancel
        self._commands[:-1] += np.diff(velocity, axis=0) / dt

    def __len__(self) -> int:
        """Ticks from launch until the last UAV rests at its goal."""
        return len(self._commands) - 1

    def __call__(self, ticks: int | NDArray[np.intp]) -> Floats:
        """Accelerations `(M, d)`, m/s²: (v_{k+1} − v_k)/dt + c0(v_k − v_o), and those of the hover after the end.

        Args:
            ticks: since each launch, one number or `(M,)`; a negative number counts as 0.
        """
        return self._commands[np.clip(ticks, 0, len(self)), np.arange(self._commands.shape[1])]


class Offline(Controller):
    """Flies a path computed before take-off, without feedback of its state.

    `[offline]` limits speed and acceleration.
    """

    name = "offline"
    dimensions = (2, 3)

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._plans: dict[bytes, OpenLoopPlan] = {}  # by the bytes of the starts

    def init(self, uavs: NDArray[np.intp], plan: state.States) -> Memory:
        memory = {"start": plan[uavs] - mission.goal_states(self.scenario)[uavs]}
        return memory | {"launch": mission.launches(self.scenario)[uavs].astype(np.int32)}

    def step(self, memory: Memory, tick: int, own: state.States, received: Sequence[Received]) -> Step:
        starts = memory["start"]
        plan = self._plans.get(key := starts.tobytes())
        if plan is None:
            plan = self._plans[key] = OpenLoopPlan(self.scenario, starts)
        return Step(memory, plan(tick - memory["launch"]))
