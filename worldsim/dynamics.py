"""Motion under command, drag and Ornstein–Uhlenbeck wind, Eq. sd_a and sd_b."""

import math

import numpy as np

from swarm import state
from swarm.scenario import Scenario


def step(scenario: Scenario, states: state.States, accelerations: state.Plane, noise: state.Plane) -> state.States:
    """One Euler–Maruyama step: dv = a dt − c0(v − v_o)dt + σ_wind dW, then dr = v dt with the new v.

    V_o = σ_wind·I acts as a standard deviation; the paper calls it a covariance.

    Args:
        states: (..., 4). accelerations: (..., 2), m/s². noise: (..., 2), standard normal.
    """
    wind, dt = scenario.wind, scenario.dt
    velocity = states[..., state.VELOCITY]
    pull = accelerations - wind.drag * (velocity - np.array(wind.mean))
    moved = np.empty_like(states)
    moved[..., state.VELOCITY] = velocity + dt * pull + (wind.sigma * math.sqrt(dt)) * noise
    moved[..., state.POSITION] = states[..., state.POSITION] + dt * moved[..., state.VELOCITY]
    return moved
