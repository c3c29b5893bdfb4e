"""The fading of one slot after another, drawn ahead: a call for every slot of a tick costs more than its numbers."""

from bisect import bisect_left
from typing import Any

import numpy as np
from numpy.typing import NDArray

from channel.rician import squared_amplitude
from swarm.scenario import Radio
from swarm.seeds import random_state, set_random_state

_BLOCK = 4096  # amplitudes at a time: four ticks of 25 UAVs that all speak, and not yet out of the caches


class Fading:
    """z² of slots in the order in which they are asked for, as if each were drawn from the generator when it is."""

    def __init__(self, draw: np.random.Generator, radio: Radio) -> None:
        """`draw` is this object's own from now on."""
        self._draw, self._radio = draw, radio
        self._ahead: NDArray[np.float64] = np.empty(0)
        self._used = 0  # of those ahead
        self._failed: NDArray[np.intp] | None = None  # which of them are below
        self._threshold = 0.0
        self._places = memoryview(b"")  # the same; it is searched in a fraction of the time
        self._asked, self._last = -1, 0  # up to where was asked last, and how many of those are before
        self._before = draw.bit_generator.state  # where the generator was before it drew the last block,
        self._begin = 0  # and where that begins among those ahead

    def squared(self, count: int) -> NDArray[np.float64]:
        """z² of the next `count` slots, `(count,)`; see `channel.rician`."""
        begin = self._next(count)
        return self._ahead[begin : self._used]

    def failing(self, threshold: float, count: int) -> NDArray[np.intp]:
        """In which of the next `count` slots z² is below a threshold, ascending; all ahead are compared at once."""
        begin = self._next(count)
        if self._failed is None or threshold != self._threshold:
            self._failed, self._threshold = (self._ahead < threshold).nonzero()[0], threshold
            self._places, self._asked = self._failed.data, -1
        first = self._last if begin == self._asked else bisect_left(self._places, begin)
        self._last = bisect_left(self._places, self._used, first, min(first + count, len(self._places)))
        self._asked = self._used
        return self._failed[first : self._last] - begin

    def _next(self, count: int) -> int:
        """Where the next `count` begin among those ahead."""
        if self._used + count > len(self._ahead):
            self._draw_block(count)
        begin = self._used
        self._used += count
        return begin

    def _draw_block(self, count: int) -> None:
        """Puts at least `count` ahead, more than are left."""
        left = self._ahead[self._used :]
        self._before = self._draw.bit_generator.state
        drawn = squared_amplitude(self._draw, max(_BLOCK, count - len(left)), self._radio.rice_xi, self._radio.rice_chi)
        self._ahead = np.concatenate([left, drawn]) if len(left) else drawn
        self._used, self._begin, self._failed = 0, len(left), None

    def snapshot(self) -> dict[str, Any]:
        """Where a generator is that has drawn what was asked for and nothing ahead."""
        ahead = self._draw.bit_generator.state
        self._draw.bit_generator.state = self._before
        self._draw.standard_normal((self._used - self._begin, 2))
        now = random_state(self._draw)
        self._draw.bit_generator.state = ahead
        return now

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on where a snapshot was taken."""
        set_random_state(self._draw, snapshot)
        self._ahead, self._used, self._begin, self._failed = np.empty(0), 0, 0, None
        self._before = self._draw.bit_generator.state
