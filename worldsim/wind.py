"""The mean wind at a place: everywhere the same, or with a field that varies from place to place and stays as it is.

The field is a sum of M random Fourier modes (Kraichnan, Phys. Fluids 13, 1970), w(r) = Σ a n_m cos(k_m·r + φ_m):
wave vectors k_m normal with standard deviation 1/L an axis, so that velocities are correlated over about L; unit
vectors n_m ⊥ k_m, so that no air is made or lost; phases φ_m uniform; a = rms·√(2/M), so that the mean of ‖w‖² is rms².
"""

import math

import numpy as np

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator


class MeanWind:
    """The wind of a scenario as the world has it, without its noise: a pure function of the place."""

    def __init__(self, scenario: Scenario) -> None:
        wind = scenario.wind
        self._mean = np.array(wind.mean)
        self.uniform = wind.field_rms == 0.0  # whether it is the same everywhere
        if not self.uniform:
            draw = generator(scenario.seed, "wind-field")
            self._waves = draw.standard_normal((wind.field_modes, state.AXES)) / wind.field_length
            self._phases = draw.uniform(0.0, 2.0 * math.pi, wind.field_modes)
            across = np.stack([-self._waves[:, 1], self._waves[:, 0]], axis=-1)
            length = np.sqrt(state.dot(across, across))[:, None]
            self._modes = wind.field_rms * math.sqrt(2.0 / wind.field_modes) * (across / length)

    def __call__(self, states: state.States) -> state.Plane:
        """In m/s, at each of `states` (..., 4), `(..., 2)`; `(2,)` where it is the same everywhere."""
        if self.uniform:
            return self._mean
        x, y = states[..., state.X, None], states[..., state.Y, None]
        # Products first, then a sum in NumPy's order: a row's bits do not depend on how many rows there are.
        swing = np.cos(x * self._waves[:, 0] + y * self._waves[:, 1] + self._phases)
        along = [np.add.reduce(swing * self._modes[:, axis], axis=-1) for axis in range(state.AXES)]
        return self._mean + np.stack(along, axis=-1)
