"""Keeping apart: where a UAV believes the others are, and how it is pushed away from those nearby.

The paper's interaction term aligns velocities and separates nobody. With `cost.separation` every UAV broadcasts its
state in every tick, which the radio counts, and adds to its command the negative gradient of a cost that falls with
distance. The learners see nothing of it.
"""

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers.base import Memory, Rows
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import AXES, POSITION, VELOCITY, Floats, States

FORGOTTEN_S = 1.0  # who sent nothing for so long is not nearby


class Separation:
    """What `cost.separation` asks for.

    In memory: `believed`, the states of others (M, N, 4), and `updated`, when each was last
    received, a tick (M, N).
    """

    def __init__(self, scenario: Scenario) -> None:
        self._dt, self._forgotten = scenario.dt, FORGOTTEN_S / scenario.dt
        self._weight, self._range = scenario.cost.separation, scenario.cost.separation_range

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """At take-off everybody is where the mission plan says."""
        believed = np.repeat(plan[None], len(uavs), axis=0)
        updated = np.zeros(believed.shape[:2], dtype=np.int32)
        return {"believed": believed, "updated": updated, "uav": uavs.astype(np.int32)}

    def step(
        self, memory: Memory, tick: int, own: States, received: Floats, links: tuple[Rows, Rows]
    ) -> tuple[Memory, Floats]:
        """What is believed now, and the acceleration away from those nearby, (M, 2), m/s².

        Args:
            own: (M, 4). received: (M, N, 4), `believed` with the states just received, which are a tick old,
                too. links: (L,) and (L,), the rows that received one, and of whom.
        """
        last = memory["updated"].copy()
        last[links] = tick
        believed = received.copy()
        if tick:  # since then they flew straight on
            believed[..., POSITION] += self._dt * received[..., VELOCITY]
        believed[np.arange(len(own)), memory["uav"]] = own
        nearby = np.where((tick - last <= self._forgotten)[..., None], believed, np.inf)
        pushed = np.empty((len(own), AXES))
        kernels.repel(np.ascontiguousarray(own), nearby, self._weight, self._range, pushed)
        return memory | {"believed": believed, "updated": last}, pushed
