"""Base class of vehicles, which move UAVs and compute their power, and the mean wind that they fly in."""

import math
from abc import abstractmethod
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator

Hidden = dict[str, NDArray]  # each (N, …)


class Vehicle:
    """Base class of vehicles. Derive from it and set `name`, which `vehicle.model` then refers to.

    Row i of every result must depend on row i of the arguments only, to the last bit. Arguments must not be written to.
    Anything besides the states [x, y, vx, vy] (m, m/s) belongs in `hidden`, which checkpoints store, and not in self.
    """

    door: ClassVar = "vehicle"
    name: ClassVar[str] = ""

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Keys of `[vehicle.options]`, with units and bounds."""

    def __init__(self, options: "Vehicle.Options", scenario: Scenario) -> None:
        """`scenario`: its `dt`, its `wind`, and whatever else the vehicle needs. Its wind is that of the world;
        `worldsim.vehicles.base.MeanWind(scenario)` gives it at a place.
        """

    def init(self, uavs: int) -> Hidden:
        """Returns the hidden state at take-off: finite arrays of numbers or booleans, (uavs, …). Empty by default."""
        return {}

    @abstractmethod
    def step(
        self, states: state.States, hidden: Hidden, acceleration: state.Plane, noise: state.Plane
    ) -> tuple[state.States, Hidden]:
        """Computes the states after one tick.

        Args:
            states: (N, 4). hidden: the result of `init` or of the last step.
            acceleration: (N, 2), m/s², the command plus the gust. noise: (N, 2), standard normal.

        Returns:
            New states (N, 4), finite float64, and the new hidden state, with the same names, shapes and dtypes. A UAV
            beyond 10⁹ m or m/s is lost: the world puts it back to its last position, at rest.
        """
        raise NotImplementedError

    @abstractmethod
    def power(self, states: state.States, hidden: Hidden, acceleration: state.Plane) -> state.Rows:
        """Returns the power in W, (N,), finite, of a step under `acceleration` to `states` (N, 4) and `hidden`."""
        raise NotImplementedError


class MeanWind:
    """Mean wind of the world, without noise: constant, or a function of the place that does not change with time.

    The field is a sum of M random Fourier modes (Kraichnan, Phys. Fluids 13, 1970), w(r) = Σ a n_m cos(k_m·r + φ_m).
    Wave vectors k_m are normal with standard deviation 1/L an axis, so velocities are correlated over about L. Unit
    vectors n_m ⊥ k_m make the field free of divergence. Phases φ_m are uniform. With a = rms·√(2/M) the mean of ‖w‖²
    is rms².

    Attributes:
        uniform: whether the wind is the same everywhere.
    """

    def __init__(self, scenario: Scenario) -> None:
        wind = scenario.wind
        self._mean = np.array(wind.mean)
        self.uniform = wind.field_rms == 0.0
        if not self.uniform:
            draw = generator(scenario.seed, "wind-field")
            self._waves = draw.standard_normal((wind.field_modes, state.AXES)) / wind.field_length
            self._phases = draw.uniform(0.0, 2.0 * math.pi, wind.field_modes)
            across = np.stack([-self._waves[:, 1], self._waves[:, 0]], axis=-1)
            length = np.sqrt(state.dot(across, across))[:, None]
            self._modes = wind.field_rms * math.sqrt(2.0 / wind.field_modes) * (across / length)

    def __call__(self, states: state.States) -> state.Plane:
        """The wind at each of `states` (..., 4), `(..., 2)`, m/s; `(2,)` if it is the same everywhere."""
        if self.uniform:
            return self._mean
        x, y = states[..., state.X, None], states[..., state.Y, None]
        # Products first, then a sum in NumPy's order: a row's bits do not depend on how many rows there are.
        swing = np.cos(x * self._waves[:, 0] + y * self._waves[:, 1] + self._phases)
        along = [np.add.reduce(swing * self._modes[:, axis], axis=-1) for axis in range(state.AXES)]
        return self._mean + np.stack(along, axis=-1)
