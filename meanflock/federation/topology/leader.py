"""One leader averages the uploads of all participants, as the paper has it."""

from meanflock.federation.topology.base import Hop, Topology
from meanflock.swarm.wire.messages import FrameKind


class LeaderTopology(Topology):
    """Participants upload to the leader's UAV, or to a station, which broadcasts the average to all."""

    name = "leader"
    bears_groups = True
    bears_clusters = False
    bears_station = True

    @property
    def broadcasters(self) -> int:
        """Number of nodes that broadcast the global model at once."""
        return 1

    def hops(self) -> tuple[Hop, ...]:
        scenario, codecs = self.scenario, self.codecs
        after = self.upload_ticks(codecs.upload)
        ticks = after + self.ticks(codecs.broadcast, self.broadcasters, len(scenario.members) - 1, self.seat)
        if ticks > scenario.period_ticks and self.must_end(codecs.upload):
            raise ValueError(
                f"`federation.period` {scenario.period_ticks} has no room for a round of {ticks} ticks, in which "
                f"models go in {codecs.upload.count} fragment{'s' * (codecs.upload.count > 1)}; take at least {ticks}"
            )
        return (
            Hop(FrameKind.UPLOAD, 0, "agent", scenario.members, codec=codecs.upload, **self.to_seat()),
            Hop(FrameKind.GLOBAL, after, "leader", self.seats, None, codecs.broadcast, "models"),
        )
