"""Motion under command, drag and Ornstein–Uhlenbeck wind, Eq. sd_a and sd_b."""

import math
from functools import lru_cache

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
    velocity = states[..., state.VELOCITY].copy()  # in one piece: loops over two numbers at a time are dear
    change = velocity - _everywhere(wind.mean, velocity.shape)
    change *= wind.drag
    np.subtract(accelerations, change, out=change)
    change *= dt
    velocity += change
    velocity += (wind.sigma * math.sqrt(dt)) * noise
    np.multiply(velocity, dt, out=change)
    change += states[..., state.POSITION]
    return np.concatenate((change, velocity), axis=-1)


@lru_cache(maxsize=8)
def _everywhere(wind: tuple[float, ...], shape: tuple[int, ...]) -> state.Plane:
    return np.broadcast_to(wind, shape).copy()
