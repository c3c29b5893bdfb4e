"""A point mass under command, drag and Ornstein–Uhlenbeck wind, Eq. sd_a and sd_b, with a rotary wing, Eq. Power1."""

import math

import numpy as np

from meanflock import kernels
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles import rotor
from meanflock.worldsim.vehicles.base import Hidden, MeanWind, Vehicle


class PointMass(Vehicle):
    """A point mass in an Ornstein–Uhlenbeck wind, with the power of a rotary wing. The constants are the keys of
    `[vehicle]` and `[wind]`."""

    name = "point-mass"
    dimensions = (2, 3)

    def __init__(self, options: Vehicle.Options, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._wind = scenario.wind
        self._vehicle = scenario.vehicle
        self._dt = scenario.dt
        self._mean = MeanWind(scenario)
        self._through_air = scenario.vehicle.power_speed == "air"
        self._shake = scenario.wind.sigma * math.sqrt(scenario.dt)

    def step(
        self, states: state.States, hidden: Hidden, acceleration: state.Vectors, noise: state.Vectors
    ) -> tuple[state.States, Hidden]:
        """One Euler–Maruyama step: dv = a dt − c0(v − v_o(r))dt + σ_wind dW, then dr = v dt with the new v.

        V_o = σ_wind·I acts as a standard deviation; the paper calls it a covariance.
        """
        moved = np.empty(states.shape)
        kernels.move(
            np.ascontiguousarray(states),
            np.ascontiguousarray(acceleration),
            np.ascontiguousarray(noise),
            self._mean(states),
            self._wind.drag,
            self._shake,
            self._dt,
            moved,
        )
        return moved, hidden

    def power(self, states: state.States, hidden: Hidden, acceleration: state.Vectors) -> state.Rows:
        """Power of the rotary wing at speed ‖v‖, or at ‖v − v_o(r)‖ if `vehicle.power_speed` is air; v_o is the mean
        wind without noise. UAVs that climb or sink need that of momentum theory, see `rotor`."""
        through = state.velocity(states)
        if self._through_air:
            through = through - self._mean(states)
            speed = np.sqrt(state.dot(through, through))
        else:
            speed = state.length(through)
        power = self._vehicle.power(speed * speed, speed)
        if through.shape[-1] == state.SPACE:
            steep = np.flatnonzero(through[:, 2])
            level = state.length(state.flat(through[steep]))
            power[steep] = rotor.power(self._vehicle, level, through[steep, 2], speed[steep])
        return power
