"""How a head writes what it hands on: the mean of its cluster and the number of models in it, as floats of the radio.

The number is the last float of a row: the leader weighs by it, and it is paid for like every weight. Means are not
written more coarsely than that: what a byte a weight would take from them, no later upload could give back.
"""

import numpy as np

from meanflock.swarm.ascending import contains
from meanflock.swarm.clusters import Clusters
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.control import expect
from meanflock.swarm.wire.payload import Coding


class Relay(Coding):
    """The writing of relays, `(S, L + 1)` floats a batch: means, then counts."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario.radio_payload, (scenario.declared.parameters + 1,))
        self._clusters = Clusters(scenario)

    def check_relays(self, source: np.ndarray, payload: np.ndarray) -> None:
        """Lets through what came by network as the relays of the UAVs `source` (S,).

        Raises:
            MessageRejected: `wrong-shape`: not of this shape, not of a head, or of more models than its cluster has.
        """
        expect("payload", payload, (len(source), self.width), self.dtype)
        if not contains(self._clusters.heads, source).all():
            raise MessageRejected("wrong-shape", f"relays of UAVs {source.tolist()}, which head no cluster")
        counts = payload[:, -1].astype(np.float64)
        most = self._clusters.sizes[self._clusters.of[source]]
        if ((counts < 1) | (counts > most) | (np.floor(counts) != counts)).any():
            raise MessageRejected("wrong-shape", f"relays of {counts.tolist()} models")
