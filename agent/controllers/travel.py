"""Straight to the goal at cruise speed, and slower near it."""

from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Memory
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import AXES, POSITION, VELOCITY, Plane, Rows, States

SLOWING_1_S = 0.5
# Options of a controller that travels.
CruiseSpeed: TypeAlias = Annotated[float, Meta(gt=0, description="cruise speed, m/s")]
Slowing: TypeAlias = Annotated[float, Meta(gt=0, description="speed near the goal, a metre from it, 1/s")]


class Travel:
    """The velocities that rows wish for, were they alone."""

    def __init__(self, scenario: Scenario, speed_m_s: float, slowing_1_s: float, stays: bool = False) -> None:
        """`stays`: who has arrived stays where that was, and does not go on to the very goal."""
        self._speed, self._slowing, self._stays = speed_m_s, slowing_1_s, stays
        self._radius = scenario.destination.radius
        self._goals = mission.goal_states(scenario)

    def init(self, uavs: NDArray[np.intp]) -> Memory:
        """The memory of rows with numbers (M,): where each goes, or stays; names begin with `travel_`."""
        memory: Memory = {"travel_end": self._goals[uavs, :AXES]}
        if self._stays:
            memory |= {"travel_uav": uavs.astype(np.int32), "travel_arrived": np.zeros(len(uavs), dtype=bool)}
        return memory

    def velocity(self, memory: Memory, own: States) -> tuple[Memory, Plane]:
        """The memory after, and where to and how fast, (M, 2) m/s: min(speed, slowing · distance) towards the goal."""
        if self._stays:
            memory = self._arrive(memory, own)
        return memory, towards(memory["travel_end"], own, self._speed, self._slowing)

    def _arrive(self, memory: Memory, own: States) -> Memory:
        arrived = memory["travel_arrived"]
        reached = state.norm(own - self._goals[memory["travel_uav"]]) <= self._radius
        reached &= ~arrived
        if not reached.any():
            return memory
        end = np.where(reached[:, None], own[:, POSITION], memory["travel_end"])
        return memory | {"travel_arrived": arrived | reached, "travel_end": end}


def towards(end: Plane, own: States, speed_m_s: Rows | float, slowing_1_s: float) -> Plane:
    """min(speed, slowing · distance) from where rows (M, 4) are to their ends, (M, 2) m: (M, 2) m/s."""
    way = end - own[:, POSITION]
    return way * np.minimum(speed_m_s / np.maximum(state.norm(way), 1e-9), slowing_1_s)[:, None]


def against_the_air(scenario: Scenario, own: States) -> Plane:
    """c0(v − v_o), (M, 2) m/s²: what undoes drag and mean wind as they are known before take-off."""
    return scenario.wind.drag * (own[:, VELOCITY] - np.array(scenario.wind.mean))


def limited(vectors: Plane, most: float) -> Plane:
    """Vectors (M, 2) made as long as `most` where they are longer."""
    return vectors * np.minimum(1.0, most / np.maximum(state.norm(vectors), 1e-9))[:, None]
