"""The vehicle door: how UAVs move under acceleration, wind and noise, and what it costs them."""

from abc import abstractmethod
from typing import ClassVar

import msgspec
from numpy.typing import NDArray

from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario

Hidden = dict[str, NDArray]  # each (N, …)


class Vehicle:
    """N UAVs of one kind. Derive from it, give it a `name`, and `vehicle.model` can name it.

    Row i of every result depends on row i of the arguments only, to the last bit; arguments are not written to. All
    that a UAV is besides its state [x, y, vx, vy] (m, m/s) lies in `hidden`, which is kept in checkpoints, not in self.
    """

    door: ClassVar = "vehicle"
    name: ClassVar[str] = ""

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """The keys of `[vehicle.options]`, with units and bounds."""

    def __init__(self, options: "Vehicle.Options", scenario: Scenario) -> None:
        """`scenario`: for its `dt`, `wind` and whatever else the vehicle goes by. Its wind is the world's, whatever the
        UAVs are told of it; `worldsim.wind.MeanWind(scenario)` has it at a place.
        """

    def init(self, uavs: int) -> Hidden:
        """The hidden state at take-off: arrays of numbers or booleans, (uavs, …) each, finite. None by default."""
        return {}

    @abstractmethod
    def step(
        self, states: state.States, hidden: Hidden, acceleration: state.Plane, noise: state.Plane
    ) -> tuple[state.States, Hidden]:
        """One tick.

        Args:
            states: (N, 4). hidden: as `init` or the last step made it.
            acceleration: (N, 2), m/s², what was commanded and the gust. noise: (N, 2), standard normal.

        Returns:
            New states (N, 4), finite float64, and the new hidden state, of the same names, shapes and dtypes. A UAV
            10⁹ m or m/s from the origin is lost: it is put back to where it was, at rest.
        """
        raise NotImplementedError

    @abstractmethod
    def power(self, states: state.States, hidden: Hidden, acceleration: state.Plane) -> state.Rows:
        """What a step under `acceleration` costs, (N,) in W, finite; `states` (N, 4) and `hidden` as it left them."""
        raise NotImplementedError
