"""What it costs to fly a metre in a wind: the power of the rotary wing, Eq. Power1, at the speed that costs power."""

import numpy as np

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

SPEEDS_M_S = np.linspace(0.5, 6.0, 45)  # over ground, that are compared


class Fare:
    """Energy and time, J + μ s, of a metre, at the speed over ground that makes it least."""

    def __init__(self, scenario: Scenario, time_price_w: float) -> None:
        """`time_price_w`: μ, what a second costs beside the energy, J."""
        self._vehicle, self._price = scenario.vehicle, time_price_w
        self._through_air = scenario.vehicle.power_speed == "air"

    def best(self, along: Floats, across: Floats) -> tuple[Floats, Floats]:
        """The least J/m with that price, and the m/s over ground it takes.

        Args:
            along, across: components of the wind in m/s, in the direction of flight and at right angles to it.
        """
        if not self._through_air:
            along, across = np.zeros_like(along), np.zeros_like(across)
        headway = SPEEDS_M_S - along[..., None]
        squared = headway * headway + (across * across)[..., None]
        each = (self._vehicle.power(squared, np.sqrt(squared)) + self._price) / SPEEDS_M_S
        which = np.argmin(each, axis=-1)
        return np.take_along_axis(each, which[..., None], axis=-1)[..., 0], SPEEDS_M_S[which]
