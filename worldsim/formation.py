"""Where the swarm stands at t = 0."""

import math

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario


def initial_states(scenario: Scenario) -> state.States:
    """A square grid at rest, centred where the scenario says; an N that is no square leaves the last row short.

    Returns:
        (N, 4): UAV k stands in column k mod w and row k div w of a grid w = ⌈√N⌉ wide.
    """
    width = math.isqrt(scenario.uavs - 1) + 1
    number = np.arange(scenario.uavs)
    states = np.zeros((scenario.uavs, state.SIZE))
    last_row = (scenario.uavs - 1) // width
    states[:, state.X] = scenario.start.centre[0] + scenario.start.spacing * (number % width - (width - 1) / 2)
    states[:, state.Y] = scenario.start.centre[1] + scenario.start.spacing * (number // width - last_row / 2)
    return states
