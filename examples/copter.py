"""A vehicle in a file: a copter in the plane, which tilts in order to accelerate, with a delay and a largest angle.

Rotors that carry the mass m and accelerate it by a need the thrust m √(g² + ‖a‖²), and their induced power grows with
the thrust to the power of 3/2 (momentum theory).

    meanflock run --plugin examples/copter.py --set vehicle.model=copter --method plan
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf
from meanflock.worldsim.vehicles.base import MeanWind

GRAVITY = 9.81  # m/s²


class Copter(mf.Vehicle):
    """A copter in the wind of the scenario."""

    name = "copter"

    class Options(mf.Options, frozen=True):
        """Keys of the table [vehicle.options] of a scenario."""

        lag_s: Annotated[float, Meta(gt=0, description="time in which 63 % of a change of tilt happen, s")] = 0.2
        tilt_deg: Annotated[float, Meta(gt=0, lt=90, description="largest tilt, °")] = 30.0
        hover_W: Annotated[float, Meta(gt=0, description="power of the rotors in hover, W")] = 0.1

    def __init__(self, options, scenario):
        """Computes what stays the same during a flight."""
        super().__init__(options, scenario)
        self.wind = MeanWind(scenario)
        self.share = 1.0 - math.exp(-scenario.dt / options.lag_s)  # of a change of tilt that happens in a tick
        self.most = GRAVITY * math.tan(math.radians(options.tilt_deg))  # m/s²

    def init(self, uavs):
        """No UAV is tilted at take-off."""
        return {"thrust": np.zeros((uavs, 2))}

    def step(self, states, hidden, acceleration, noise):
        """The horizontal thrust, m/s², approaches the command; drag and noise are those of the point mass."""
        dt, wind = self.scenario.dt, self.scenario.wind
        length = np.sqrt((acceleration**2).sum(axis=1, keepdims=True))
        wanted = acceleration * (self.most / np.maximum(length, self.most))
        thrust = hidden["thrust"] + self.share * (wanted - hidden["thrust"])
        drag = wind.drag * (states[:, 2:] - self.wind(states))
        velocity = states[:, 2:] + dt * (thrust - drag) + wind.sigma * math.sqrt(dt) * noise
        return np.concatenate([states[:, :2] + dt * velocity, velocity], axis=1), {"thrust": thrust}

    def power(self, states, hidden, acceleration):
        """Induced power: that of hover, times the 3/2 power of the thrust in g."""
        squared = 1.0 + (hidden["thrust"] ** 2).sum(axis=1) / GRAVITY**2
        root = np.sqrt(squared)
        return self.options.hover_W * root * np.sqrt(root)
