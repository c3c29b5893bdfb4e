"""The fading of one slot after another."""

import numpy as np
from numpy.typing import NDArray

from channel.rician import squared_amplitude
from swarm.normals import Normals
from swarm.scenario import Radio

Floats = NDArray[np.float64]


class Fading(Normals):
    """Amplitudes of slots in the order in which they are asked for: a pair of normal numbers a slot, and their law."""

    def __init__(self, draw: np.random.Generator, radio: Radio) -> None:
        """`draw` is this object's own from now on."""
        super().__init__(draw)
        self.xi, self.chi = radio.rice_xi, radio.rice_chi

    def squared(self, count: int) -> Floats:
        """z² of the next `count` slots, `(count,)`; see `channel.rician`."""
        return squared_amplitude(self.take(count), self.xi, self.chi)
