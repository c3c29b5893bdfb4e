"""The corridor of a mission: from the middle of all starts to the middle of all goals, the same for every UAV."""

import numpy as np

from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Scenario

SHORTEST_M = 1.0


class Corridor:
    """Attributes:
    goals: (N, 2) m. launches: (N,) ticks. goal: (2,) m, the middle of the goals. back: (2,) unit vector from it
        towards the starts. length_m: of the longest way.
    """

    def __init__(self, scenario: Scenario) -> None:
        starts = mission.starts(scenario)[:, state.POSITION]
        self.goals, self.launches = mission.goals(scenario), mission.launches(scenario)
        self.goal = self.goals.mean(axis=0)
        way = starts.mean(axis=0) - self.goal
        length = float(np.sqrt(state.dot(way, way)))
        self.back = way / length if length >= SHORTEST_M else np.array([1.0, 0.0])
        along = state.dot(starts - self.goals, np.broadcast_to(self.back, starts.shape))
        self.length_m = max(SHORTEST_M, float(along.max()))
