"""Goals of the rows of a controller, which may change in flight."""

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Memory, replaced
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Vectors


class Goals:
    """The goals of the mission. Only where they may change, a memory has them, as `goal`."""

    def __init__(self, scenario: Scenario) -> None:
        self._first = mission.goals(scenario)
        self.are_guided = scenario.is_guided

    def init(self, uavs: NDArray[np.intp]) -> Memory:
        """Memory of rows with numbers (M,)."""
        return {"goal": self._first[uavs]} if self.are_guided else {}

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        """Memory after some rows were given other goals, (len(rows), d) m."""
        return memory | {"goal": replaced(memory["goal"], rows, goals)}

    def of(self, memory: Memory, uavs: NDArray[np.integer]) -> Vectors:
        """Goals (M, d), m, of rows with numbers (M,)."""
        goals: Vectors = memory["goal"] if self.are_guided else self._first[uavs]
        return goals
