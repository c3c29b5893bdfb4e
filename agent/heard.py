"""Taking in states by radio: who hears whom is mostly as it was a tick ago, and then known to be sound."""

import numpy as np
from numpy.typing import NDArray

from swarm import state
from swarm.messages import Frames

Floats = NDArray[np.float64]


class Heard:
    """The links of the last states a node of M UAVs heard, and where these belong among all it knows."""

    def __init__(self, uavs: NDArray[np.intp], everyone: int) -> None:
        """`uavs`: (M,), ascending. `everyone`: N."""
        self._own = np.arange(len(uavs)) * everyone + uavs  # of M · N states, those of the UAVs themselves
        self._uavs, self._everyone = uavs, everyone
        self._links = b"", b""
        self._sent = self._place = np.zeros(0, dtype=np.intp)
        self._all = False  # whether every UAV hears every other

    def again(self, frames: Frames) -> bool:
        """Whether these are the sources and links of the last time."""
        return self._links == _links(frames)

    def take_in(self, frames: Frames, known: Floats) -> None:
        """The states in sound frames replace what was known, `known` (M, N, 4)."""
        if not self.again(frames):
            self._learn(frames)
        flat = known.reshape(-1, state.SIZE)
        if self._all:
            own = flat[self._own]
            known[...] = frames.payload
            flat[self._own] = own
        else:
            flat[self._place] = frames.payload.astype(np.float64).take(self._sent, axis=0)

    def _learn(self, frames: Frames) -> None:
        assert frames.links is not None
        self._links = _links(frames)
        self._sent = frames.links[:, 0].astype(np.intp)
        row = self._uavs.searchsorted(frames.links[:, 1])
        self._place = row * self._everyone + frames.source[self._sent]
        others = np.ones(len(self._uavs) * self._everyone, dtype=bool)
        others[self._place] = others[self._own] = False
        self._all = np.array_equal(frames.source, np.arange(self._everyone)) and not others.any()


def _links(frames: Frames) -> tuple[bytes, bytes]:
    assert frames.links is not None
    return frames.source.tobytes(), frames.links.tobytes()
