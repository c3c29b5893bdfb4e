"""What a UAV does for its cluster if it is the head: collects the uploads of a round, and hands on their mean."""

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.ascending import contains, distinct
from meanflock.swarm.clusters import Clusters
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.mean import refuse, relayed
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import payload
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.swarm.wire.relay import Relay


class Heads:
    """The heads of clusters among the UAVs of a node; none where the leader averages alone."""

    def __init__(self, scenario: Scenario, uavs: NDArray[np.intp]) -> None:
        clusters = Clusters(scenario)
        self._heads = uavs[contains(distinct(clusters.heads), uavs)] if scenario.federation.clusters > 1 else uavs[:0]
        self._head_of = clusters.head_of
        self._up, self._relay = payload.upload(scenario), Relay(scenario)
        self._arrived: dict[tuple[int, int], dict[int, Floats]] = {}  # round and head → UAV → model

    def check(self, frames: Frames) -> None:
        """Lets through uploads, their links sound, of UAVs whose head is here.

        Raises:
            MessageRejected: `wrong-kind`, `wrong-shape` or `non-finite`.
        """
        if not len(self._heads):
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames are not for an agent that heads no cluster")
        self._up.check(frames.payload, len(frames.source))
        assert frames.links is not None
        sent, to = frames.links[:, 0], frames.links[:, 1]
        if (self._head_of[frames.source[sent]] != to).any():
            raise MessageRejected("wrong-shape", "uploads to UAVs that do not head their cluster")

    def collect(self, frames: Frames) -> None:
        """Keeps what arrived, by round, head and UAV; a second copy of the same upload changes nothing."""
        assert frames.links is not None
        models = self._up.decode(frames.payload)
        for row, head in frames.links.tolist():
            self._arrived.setdefault((frames.round, head), {}).setdefault(int(frames.source[row]), models[row])

    def relay(self, number: int, silent: NDArray[np.intp]) -> tuple[list[Frames], list[int]]:
        """What the heads, those among the UAVs `silent` excepted, send to the leader in a round, and the UAVs whose
        upload they will not average. A head that has nothing to average sends nothing."""
        relays, refused = {}, list[int]()
        for head in self._heads[~contains(distinct(silent), self._heads)].tolist():
            models, bad = refuse(self._arrived.get((number, head), {}))
            refused += bad
            if models:
                relays[head] = relayed(models)
        self._arrived = {key: models for key, models in self._arrived.items() if key[0] > number}
        if not relays:
            return [], refused
        said = self._relay.encode(np.stack(list(relays.values())))
        fits = self._relay.sound(said)  # a mean beyond the range of the radio's floats cannot be sent
        source = np.array(list(relays), dtype=np.int32)[fits]
        return [Frames(FrameKind.RELAY, number, source, said[fits])] if fits.any() else [], refused
