"""The fading of one slot after another, drawn ahead: a call for every slot of a tick costs more than its numbers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from channel.rician import squared_amplitude
from swarm.scenario import Radio
from swarm.seeds import random_state, set_random_state

Floats = NDArray[np.float64]

_BLOCK = 4096  # slots at a time: four ticks of 25 UAVs that all speak, and not yet out of the caches


class Fading:
    """Amplitudes of slots in the order in which they are asked for, as if each were drawn when it is."""

    def __init__(self, draw: np.random.Generator, radio: Radio) -> None:
        """`draw` is this object's own from now on."""
        self._draw = draw
        self.xi, self.chi = radio.rice_xi, radio.rice_chi
        self._normal: Floats = np.empty((0, 2))  # drawn ahead, from a slot on that may be over
        self._used = 0  # slots of those
        self._before = draw.bit_generator.state  # where the generator was before it drew the last block,
        self._begin = 0  # and with which slot of those ahead that begins

    def squared(self, count: int) -> Floats:
        """z² of the next `count` slots, `(count,)`; see `channel.rician`."""
        squared = squared_amplitude(self.ahead(count)[:count], self.xi, self.chi)
        self.use(count)
        return squared

    def ahead(self, count: int) -> Floats:
        """Standard normal numbers of the next slots, two a slot, of `count` at least; and so many must be used then."""
        if self._used + count > len(self._normal):
            left = self._normal[self._used :]
            normal = np.empty((max(_BLOCK, count), 2))
            normal[: len(left)] = left
            self._before = self._draw.bit_generator.state
            self._draw.standard_normal(out=normal[len(left) :])
            self._normal, self._used, self._begin = normal, 0, len(left)
        return self._normal[self._used :]

    def use(self, count: int) -> None:
        """The next `count` slots are over."""
        self._used += count

    def snapshot(self) -> dict[str, Any]:
        """Where a generator is that has drawn what was used and nothing ahead."""
        ahead = self._draw.bit_generator.state
        self._draw.bit_generator.state = self._before
        self._draw.standard_normal((self._used - self._begin, 2))
        now = random_state(self._draw)
        self._draw.bit_generator.state = ahead
        return now

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on where a snapshot was taken."""
        set_random_state(self._draw, snapshot)
        self._normal, self._used, self._begin = np.empty((0, 2)), 0, 0
        self._before = self._draw.bit_generator.state
