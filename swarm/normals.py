"""Standard normal numbers drawn ahead: a call for every few of them costs more than they do."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarm.seeds import random_state, set_random_state

Floats = NDArray[np.float64]

_BLOCK = 4096  # pairs at a time: those of many ticks, and not yet out of the caches


class Normals:
    """Pairs of them in the order in which they are asked for, as if each were drawn when it is."""

    def __init__(self, draw: np.random.Generator) -> None:
        """`draw` is this object's own from now on."""
        self._draw = draw
        self._pairs: Floats = np.empty((0, 2))  # drawn ahead, from one on that may be used
        self._used = 0  # of those
        self._before = draw.bit_generator.state  # where the generator was before it drew the last block,
        self._begin = 0  # and with which of those ahead that begins

    def ahead(self, count: int) -> Floats:
        """The next pairs, `count` of them at least; and so many must be used then."""
        if self._used + count > len(self._pairs):
            left = self._pairs[self._used :]
            pairs = np.empty((max(_BLOCK, count), 2))
            pairs[: len(left)] = left
            self._before = self._draw.bit_generator.state
            self._draw.standard_normal(out=pairs[len(left) :])
            self._pairs, self._used, self._begin = pairs, 0, len(left)
        return self._pairs[self._used :]

    def use(self, count: int) -> None:
        """The next `count` pairs are used."""
        self._used += count

    def take(self, count: int) -> Floats:
        """The next pairs, `(count, 2)`, used; not to be written to."""
        taken = self.ahead(count)[:count]
        self.use(count)
        return taken

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
        self._pairs, self._used, self._begin = np.empty((0, 2)), 0, 0
        self._before = self._draw.bit_generator.state
