"""Straight flight to the goal at cruise speed: the controller `cruise`, and parts that other controllers use."""

from collections.abc import Sequence
from typing import Annotated, Any, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller, Memory, Received, Step, replaced
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Rows, States, Vectors

CRUISE_M_S = 2.25  # speed of least energy per metre of the paper's craft
SLOWING_1_S = 0.5
# Options of a controller that travels.
CruiseSpeed: TypeAlias = Annotated[float, Meta(gt=0, description="cruise speed, m/s")]
Slowing: TypeAlias = Annotated[float, Meta(gt=0, description="speed near the goal, a metre from it, 1/s")]


class Travel:
    """Velocities that rows would fly if they were alone."""

    def __init__(self, scenario: Scenario, speed_m_s: float, slowing_1_s: float, stays_inside: bool = False) -> None:
        """`stays_inside`: a UAV stays where it entered the destination, and does not fly on to the goal."""
        self._speed = speed_m_s
        self._slowing = slowing_1_s
        self._stays_inside = stays_inside
        self._radius = scenario.destination.radius
        self._goals = mission.goal_states(scenario)
        self._is_guided = scenario.is_guided

    def init(self, uavs: NDArray[np.intp]) -> Memory:
        """Memory of rows with numbers (M,): the point to which each flies. Names begin with `travel_`."""
        memory: Memory = {"travel_end": state.position(self._goals[uavs])}
        if self._stays_inside:
            memory |= {"travel_uav": uavs.astype(np.int32), "travel_arrived": np.zeros(len(uavs), dtype=bool)}
            if self._is_guided:
                memory["travel_goal"] = self._goals[uavs]
        return memory

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        """Memory after some rows were given other goals, (len(rows), d) m."""
        memory = memory | {"travel_end": replaced(memory["travel_end"], rows, goals)}
        if self._stays_inside:
            memory["travel_arrived"] = replaced(memory["travel_arrived"], rows, False)
            memory["travel_goal"] = replaced(memory["travel_goal"], rows, state.at_rest(goals))
        return memory

    def velocity(self, memory: Memory, own: States) -> tuple[Memory, Vectors]:
        """Memory after the tick, and velocities (M, 2) m/s: min(speed, slowing · distance) towards the goal."""
        if self._stays_inside:
            memory = self._arrive(memory, own)
        return memory, towards(memory["travel_end"], own, self._speed, self._slowing)

    def _arrive(self, memory: Memory, own: States) -> Memory:
        arrived = memory["travel_arrived"]
        goals = memory["travel_goal"] if self._is_guided else self._goals[memory["travel_uav"]]
        reached = state.norm(own - goals) <= self._radius
        reached &= ~arrived
        if not reached.any():
            return memory
        end = np.where(reached[:, None], state.position(own), memory["travel_end"])
        return memory | {"travel_arrived": arrived | reached, "travel_end": end}


def towards(end: Vectors, own: States, speed_m_s: Rows | float, slowing_1_s: float) -> Vectors:
    """Velocities (M, 2) m/s from rows (M, 4) towards their ends (M, 2) m: min(speed, slowing · distance)."""
    way = end - state.position(own)
    return way * np.minimum(speed_m_s / np.maximum(state.norm(way), 1e-9), slowing_1_s)[:, None]


def against_the_air(scenario: Scenario, own: States) -> Vectors:
    """Acceleration c0(v − v_o), (M, 2) m/s², that cancels drag and mean wind as they are known before take-off."""
    return scenario.wind.drag * (state.velocity(own) - scenario.space.vector(scenario.wind.mean))


def acceleration_limit(scenario: Scenario, most: float) -> float:
    """The limit of a controller, or that of the vehicle if it is lower, m/s²."""
    limit = scenario.vehicle.acceleration_max
    return most if limit is None else min(most, limit)


def limited(vectors: Vectors, most: float) -> Vectors:
    """Vectors (M, 2), those longer than `most` shortened to it."""
    return vectors * np.minimum(1.0, most / np.maximum(state.norm(vectors), 1e-9))[:, None]


class Cruise(Controller):
    """Flies straight to its goal at one speed; uses no states of other UAVs.

    a = k_v (v_ref − v) + c0 (v − v_o), v_ref = min(speed, slowing · distance) towards the goal. It stays where it
    arrives, and sends nothing.
    """

    name = "cruise"
    guided = True
    dimensions = (2, 3)
    broadcast_numbers = 0

    class Options(base.Options, frozen=True):
        """The options of `cruise`."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        slowing_1_s: Slowing = SLOWING_1_S
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 1.0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._travel = Travel(scenario, options.speed_m_s, options.slowing_1_s, stays_inside=True)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return self._travel.init(uavs)

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        return self._travel.guide(memory, rows, goals)

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        memory, wanted = self._travel.velocity(memory, own)
        acceleration = self.options.velocity_gain_1_s * (wanted - state.velocity(own))
        return Step(memory, acceleration + against_the_air(self.scenario, own))
