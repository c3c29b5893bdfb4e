"""How a head writes what it hands on: the mean of its cluster and the number of models in it, as floats of the radio.

The number is the last float of a row: the leader weighs by it, and it is paid for like every weight. Means are not
written more coarsely than that: what a byte a weight would take from them, no later upload could give back.
"""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.ascending import contains
from meanflock.swarm.clusters import Clusters
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.control import FLOAT_OF_BITS, expect


class Relay:
    """The writing of relays, `(S, L + 1)` floats a batch: means, then counts."""

    def __init__(self, scenario: Scenario) -> None:
        self._clusters = Clusters(scenario)
        self.dtype = FLOAT_OF_BITS[scenario.radio.bits_per_float]
        self.width = scenario.declared.parameters + 1

    @property
    def bits(self) -> int:
        """What a transmission pays for."""
        return 8 * self.dtype.itemsize * self.width

    def encode(self, relays: Floats) -> np.ndarray:
        """Means and counts `(S, L + 1)` as payloads; `sound` says which of them can be sent."""
        with np.errstate(over="ignore", under="ignore"):
            return relays.astype(self.dtype)

    def decode(self, payload: np.ndarray) -> Floats:
        """Means and counts `(S, L + 1)`."""
        return payload.astype(np.float64)

    def sound(self, payload: np.ndarray) -> NDArray[np.bool_]:
        """Which payloads can be sent, `(S,)`."""
        return np.asarray(np.isfinite(payload).all(axis=-1))

    def check(self, source: np.ndarray, payload: np.ndarray) -> None:
        """Lets through what came by network as the relays of the UAVs `source` (S,).

        Raises:
            MessageRejected: `wrong-shape`: not of this shape, not of a head, or of more models than its cluster has.
        """
        expect("payload", payload, (len(source), self.width), self.dtype)
        if not contains(self._clusters.heads, source).all():
            raise MessageRejected("wrong-shape", f"relays of UAVs {source.tolist()}, which head no cluster")
        counts = payload[:, -1].astype(np.float64)
        if (
            (counts < 1) | (counts > self._clusters.sizes[self._clusters.of[source]]) | (np.floor(counts) != counts)
        ).any():
            raise MessageRejected("wrong-shape", f"relays of {counts.tolist()} models")
