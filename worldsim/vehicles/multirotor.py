"""A multirotor as a point mass whose thrust follows the command with a lag: a rigid body's motion at little cost."""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta

from meanflock import kernels
from meanflock.kernels.quadrotor import GRAVITY
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.base import Hidden, MeanWind, Vehicle

_AIR = 1.225  # density, kg/m³


class Multirotor(Vehicle):
    """A multirotor whose thrust vector follows the wanted one by first order.

    The level parts follow as fast as the attitude turns, the vertical part as fast as the rotors do. For small tilts
    these are the two lags of a rigid body. Without lags it moves as the point mass does. Gusts and the mean wind push
    it; it tracks its command alone.
    """

    name = "multirotor"
    dimensions = (3,)
    push = True
    columns = ("roll_rad", "pitch_rad", "yaw_rad", "thrust_N")

    class Options(Vehicle.Options, frozen=True):
        """Keys of `[vehicle.options]`. The time constants are those of the vehicle `quadrotor`: k_d/k_p, and tau_s."""

        mass_kg: Annotated[float, Meta(gt=0, description="mass, kg")] = 0.5
        attitude_s: Annotated[float, Meta(gt=0, description="time constant of the attitude, s")] = 0.086
        thrust_s: Annotated[float, Meta(gt=0, description="time constant of the thrust, s")] = 0.005
        thrust_max_N: Annotated[float, Meta(gt=0, description="largest thrust, N")] = 50.0
        disc_m2: Annotated[float, Meta(gt=0, description="area that all rotors sweep, m²")] = 0.126
        figure_of_merit: Annotated[
            float, Meta(gt=0, le=1, description="ideal over real power of the rotors in hover, 1")
        ] = 0.6

    options: Options

    def __init__(self, options: Options, scenario: Scenario) -> None:
        """Raises BadInput if the largest thrust does not carry the mass."""
        super().__init__(options, scenario)
        if not options.thrust_max_N > (weight := options.mass_kg * GRAVITY):
            raise BadInput(
                f"vehicle 'multirotor': `thrust_max_N` = {options.thrust_max_N:g} does not lift `mass_kg`, which "
                f"weighs {weight:.3g} N; raise it, or lower the mass"
            )
        lags = np.array([options.attitude_s, options.attitude_s, options.thrust_s])
        self._left = np.exp(-scenario.dt / lags)  # shares of a deviation that are left after a tick
        self._mean_left = lags / scenario.dt * -np.expm1(-scenario.dt / lags)  # and their means over a tick
        self._most = options.thrust_max_N / options.mass_kg
        self._weight = np.array([0.0, 0.0, GRAVITY])
        self._mean = MeanWind(scenario)
        self._shake = scenario.wind.sigma * math.sqrt(scenario.dt)

    def init(self, uavs: int) -> Hidden:
        """The thrust over the mass, m/s², (uavs, 3), of a UAV in hover."""
        return {"thrust": np.tile(self._weight, (uavs, 1))}

    def rest(self, hidden: Hidden) -> Hidden:
        """Hover."""
        return self.init(len(hidden["thrust"]))

    def step(  # type: ignore[override]  # with `push`
        self,
        states: state.States,
        hidden: Hidden,
        acceleration: state.Vectors,
        noise: state.Vectors,
        push: state.Vectors,
    ) -> tuple[state.States, Hidden]:
        """The step of the point mass under the mean thrust of the tick. The lag is exact: τ u' = wanted − u."""
        wanted = acceleration + self._weight
        np.maximum(wanted[:, 2], 0.0, out=wanted[:, 2])  # no rotor pulls down
        wanted *= (self._most / np.maximum(state.length(wanted), self._most))[:, None]
        behind = hidden["thrust"] - wanted
        moved = np.empty(states.shape)
        kernels.move(
            np.ascontiguousarray(states),
            wanted + self._mean_left * behind - self._weight + push,
            np.ascontiguousarray(noise),
            self._mean(states),
            self.scenario.wind.drag,
            self._shake,
            self.scenario.dt,
            moved,
        )
        return moved, {"thrust": wanted + self._left * behind}

    def power(self, states: state.States, hidden: Hidden, acceleration: state.Vectors) -> state.Rows:
        """Induced power in hover by momentum theory over the figure of merit, T √(T / (2ρA)) / FM."""
        thrust = self._thrust(hidden)
        ideal: state.Rows = thrust * np.sqrt(thrust / (2.0 * _AIR * self.options.disc_m2))
        return ideal / self.options.figure_of_merit

    def shown(self, hidden: Hidden) -> state.Floats:
        """Roll and pitch by which R_y R_x turns the vertical to the thrust, yaw 0, and thrust."""
        x, y, z = state.parts(hidden["thrust"])
        roll = np.arctan2(0.0 - y, np.sqrt(x * x + z * z))
        return np.stack([roll, np.arctan2(x, z), np.zeros(len(x)), self._thrust(hidden)], axis=-1)

    def _thrust(self, hidden: Hidden) -> state.Rows:
        return self.options.mass_kg * state.length(hidden["thrust"])
