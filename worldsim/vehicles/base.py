"""Base class of vehicles, which move UAVs under acceleration, wind and noise and compute their power."""

from abc import abstractmethod
from typing import ClassVar

import msgspec
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario

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
        `worldsim.wind.MeanWind(scenario)` gives it at a place.
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
